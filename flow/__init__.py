"""What becomes of the RTL: synthesis, gate-level simulation, place and route, and their costs. Nothing else imports it but the command line."""
