"""Physical constants, exact SI values, and conversions that follow from definitions alone."""

import math

SPEED_OF_LIGHT_M_S = 299_792_458.0
PLANCK_J_S = 6.626_070_15e-34
SIGMA_PER_FWHM = 1 / math.sqrt(8 * math.log(2))  # of a Gaussian
