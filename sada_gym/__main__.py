"""`python -m sada_gym`: the command line."""

from sada_gym.cli import main

if __name__ == "__main__":
    main()
