"""`python -m thigmo`: the same command line."""

from thigmo.cli.main import main

main()
