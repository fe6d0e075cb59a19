"""``python -m glisson`` is the program ``glisson``."""

import os
import signal
import sys

from glisson._glisson import _run_main


def main() -> None:
    # Ctrl + C ends the program, which does not come back to Python before it is done.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # What it starts of the package is started with this Python.
    os.environ.setdefault("GLISSON_PYTHON", sys.executable)
    sys.exit(_run_main(sys.argv[1:]))


if __name__ == "__main__":
    main()
