"""The `thigmo` command, and `python -m thigmo`."""

from __future__ import annotations

from thigmo.cli import ending


def run() -> None:
    """Run the command line; Ctrl-C ends it with one line, while it still loads as well."""
    ending.be_ready()
    try:
        from thigmo.cli.main import main

        main()
    except KeyboardInterrupt:
        ending.leave()
    finally:
        ending.be_done()


if __name__ == "__main__":
    run()
