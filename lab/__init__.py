# SPDX-License-Identifier: Apache-2.0
"""The experiment: what is tried (`setup.py`), what came out (`outcomes.py`, `measures.py`), and many of them (`campaign.py`)."""
