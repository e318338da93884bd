"""The page's server, for tests with a browser and without one."""

from __future__ import annotations

import asyncio
import threading

from thigmo.live.server import WatchOptions, serve


class Served:
    """The page's server, in a thread of its own."""

    def __init__(self, options: WatchOptions) -> None:
        self.address = ""
        self._up = threading.Event()
        self._loop = asyncio.new_event_loop()
        self._failure: BaseException | None = None
        self._task = self._loop.create_task(serve(options, self._announce))
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        self._up.wait()
        if self._failure is not None:
            raise self._failure

    def _announce(self, address: str) -> None:
        self.address = address
        self._up.set()

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._task)
        except asyncio.CancelledError:
            pass
        except BaseException as failure:  # noqa: BLE001 - handed to the test's thread
            self._failure = failure
        finally:
            self._up.set()
            self._loop.close()

    def close(self) -> None:
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._task.cancel)
            self._thread.join()
