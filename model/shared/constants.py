# SPDX-License-Identifier: Apache-2.0
"""Physical constants (exact SI values), conversions that follow from definitions, and the
paper's criterion of success.
"""

import math

SPEED_OF_LIGHT_M_S = 299_792_458.0
PLANCK_J_S = 6.626_070_15e-34
SIGMA_PER_FWHM = 1 / math.sqrt(8 * math.log(2))  # of a Gaussian
SUCCESS_TOLERANCE_S = (
    230e-12  # paper IV, Fig. 7: largest error of the time of flight that counts as right
)
