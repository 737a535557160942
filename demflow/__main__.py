"""`python -m demflow`."""

from demflow.sweep.command.cli import main

raise SystemExit(main())
