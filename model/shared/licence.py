# SPDX-License-Identifier: Apache-2.0
"""The line that names the licence, in every source file, including those that the project
writes.
"""

SPDX = "SPDX-License-Identifier: Apache-2.0"
