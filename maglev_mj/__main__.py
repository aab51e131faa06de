"""Program `maglev-mj`, also `python -m maglev_mj`."""

import _signal as signal  # type: ignore[import-not-found] # `signal` imports more
import os
import sys

# only if run as a program, not if imported
if (__name__ == "__main__" or os.path.basename(sys.argv[0]).startswith("maglev-mj")) and (
    signal.getsignal(signal.SIGINT) is signal.default_int_handler
):
    # exit at once during start-up and shutdown, where KeyboardInterrupt would print a traceback
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))

from maglev_mj.cli.program import main

if __name__ == "__main__":
    sys.exit(main())
