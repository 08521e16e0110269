"""`python -m envpred`: the same command line as `envpred`."""

from envpred.cli import main

if __name__ == "__main__":
    main()
