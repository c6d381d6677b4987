"""``python -m multiscale`` is the command line."""

from multiscale.cli import main

if __name__ == "__main__":  # workers import this module under another name
    main()
