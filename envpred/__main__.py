"""`python -m envpred`: the same command line as `envpred`."""

from envpred.cli import program

if __name__ == "__main__":
    program()
