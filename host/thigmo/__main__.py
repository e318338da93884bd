"""The `thigmo` command, and `python -m thigmo`."""

from __future__ import annotations

import signal

from thigmo.cli import ending


def run() -> None:
    """Run the command line; Ctrl-C ends it with one line, while it still loads as well."""
    ending.be_ready()
    try:
        from thigmo.cli.main import main
    except KeyboardInterrupt:
        ending.leave()
    try:
        main()
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # nothing is left that it could leave undone


if __name__ == "__main__":
    run()
