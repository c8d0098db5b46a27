"""``python -m swarmssm`` is the command ``swarmssm``."""

from swarmssm.cli import main

if __name__ == "__main__":
    main()
