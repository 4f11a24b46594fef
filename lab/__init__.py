# SPDX-License-Identifier: Apache-2.0
"""Experiments: a setup (`setup.py`), its outcome (`outcomes.py`, `measures.py`), and campaigns of
many setups (`campaign.py`).
"""
