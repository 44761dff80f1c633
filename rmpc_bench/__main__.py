"""`python -m rmpc_bench` is the command line."""

import sys

if __name__ == "__main__":
    if not sys.flags.safe_path:
        # Python looks for modules in the current directory first, which may be that of somebody else.
        del sys.path[0]
    from rmpc_bench.cli import main

    main(prog_name="rmpc-bench")
