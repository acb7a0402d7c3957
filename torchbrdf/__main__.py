"""`python -m torchbrdf`."""

import sys

from torchbrdf.cli import main

sys.exit(main())
