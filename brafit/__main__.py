"""`python -m brafit` is the command `brafit`."""

from brafit.app import main

if __name__ == "__main__":
    main()
