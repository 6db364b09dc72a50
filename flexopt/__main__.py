"""`python -m flexopt`: the command, where no folder of scripts is on the path."""

from flexopt.cli import main

if __name__ == "__main__":
    main()
