"""``python -m reorient``: the command line, also for launchers such as torchrun."""

from reorient.cli import main

if __name__ == "__main__":
    main()
