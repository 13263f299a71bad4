"""`python -m brafit` is the command `brafit`."""

from brafit.cli.fit import main

if __name__ == "__main__":
    main()
