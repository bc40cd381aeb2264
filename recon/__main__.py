"""The command line as a module: ``torchrun --nproc-per-node 2 -m recon fit scan.h5``."""

from recon.cli.main import main

if __name__ == "__main__":
    main(prog_name="recon")
