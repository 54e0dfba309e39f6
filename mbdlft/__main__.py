"""`python -m mbdlft`: the command line."""

from mbdlft.cli.commands import main

if __name__ == "__main__":
    main()
