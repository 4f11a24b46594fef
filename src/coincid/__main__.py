# SPDX-License-Identifier: Apache-2.0
"""`python -m coincid` is the `coincid` command."""

from coincid.cli import main

if __name__ == "__main__":
    main()
