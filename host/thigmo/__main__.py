"""The `thigmo` command, and `python -m thigmo`."""

from __future__ import annotations

import sys

from thigmo.cli import lossy_output, signals


def run() -> None:
    """Run the command line; Ctrl-C ends it with one line, while it still loads as well."""
    signals.be_ready()
    lossy_output.be_lossy()
    status: int | str | None = None
    try:
        from thigmo.cli.main import main

        main()
    except KeyboardInterrupt:
        signals.leave()
    except SystemExit as ended:
        status = ended.code
    finally:
        signals.be_done()
    sys.exit(1 if lossy_output.lost() and not status else status)


if __name__ == "__main__":
    run()
