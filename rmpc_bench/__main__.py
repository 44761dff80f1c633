"""`python -m rmpc_bench` is the command line."""

from rmpc_bench.cli import main

if __name__ == "__main__":
    main(prog_name="rmpc-bench")
