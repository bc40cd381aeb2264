"""The command line as a module: ``python -m phantomgen make kedge-small``."""

from phantomgen.cli.main import main

if __name__ == "__main__":
    main(prog_name="phantomgen")
