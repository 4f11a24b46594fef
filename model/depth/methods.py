# SPDX-License-Identifier: Apache-2.0
"""Names of the estimators; `estimate.py` runs them."""

METHODS = {
    "maximum": "highest bin of the pixel's histogram",
    "matched": "highest point of the histogram after filtering with the pulse",
    "background": "largest excess of hits over the expected background, corrected for the times when the tree is not armed",
    "planes": "likelihood of all events, fitted by planes that neighbouring pixels share",
}
DEFAULT_METHOD = "planes"
