"""`python -m ikjax.cli` is the command `ikjax`."""

import sys

from ikjax.cli import main

sys.exit(main())
