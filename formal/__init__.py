"""Formal proofs of the RTL: unbounded, by k-induction, each beside a trace that shows it is not vacuous. Nothing imports it but the command line."""
