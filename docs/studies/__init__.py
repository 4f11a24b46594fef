# SPDX-License-Identifier: Apache-2.0
"""Programs that only make pages: `python -m docs.studies.NAME`, in the folder of the checkout. They
are in no installation.
"""
