"""`python -m penumbra_kernels.hardcases`: the self-test where only the kernels' package is installed."""

import argparse
import sys

from penumbra_kernels.hardcases.selftest import SELFTEST, SelftestError

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="penumbra_kernels.hardcases",
        description=SELFTEST.DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    SELFTEST.configure(parser)
    try:
        sys.exit(SELFTEST.run(parser.parse_args()))
    except SelftestError as error:
        parser.exit(error.exit_code, f"{error}\n")
