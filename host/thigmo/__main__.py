"""The `thigmo` command, and `python -m thigmo`."""

from __future__ import annotations

import sys

from thigmo.cli import ending, unread


def run() -> None:
    """Run the command line; Ctrl-C ends it with one line, while it still loads as well."""
    ending.be_ready()
    unread.be_lossy()
    status: int | str | None = None
    try:
        from thigmo.cli.main import main

        main()
    except KeyboardInterrupt:
        ending.leave()
    except SystemExit as ended:
        status = ended.code
    finally:
        ending.be_done()
    sys.exit(1 if unread.lost() and not status else status)


if __name__ == "__main__":
    run()
