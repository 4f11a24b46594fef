# SPDX-License-Identifier: Apache-2.0
"""The line that names the licence, in every source file and in every source file that the project writes."""

SPDX = "SPDX-License-Identifier: Apache-2.0"
