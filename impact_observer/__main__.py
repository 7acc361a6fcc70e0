# SPDX-License-Identifier: Apache-2.0
"""``python -m impact_observer`` is ``impact-observer``."""

import sys

from impact_observer.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
