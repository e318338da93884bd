"""Finished runs that the page lists, opens, lays over another and compares.

They are the run folders below one folder, and the run that the page has just shown, wherever it
lies. A page names a run by its folder's name, so it can ask for no other file.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from aiohttp import web

from thigmo.contact_status import SAME_CONTACT_CM
from thigmo.errors import DataError, RunFolderError, ThigmoError
from thigmo.live.page_data import PastRun
from thigmo.record import MapContact, RunFolder
from thigmo.record.listing import compare_contacts, is_run, list_runs

_KEPT = 3  # records in memory


class PastRuns:
    """The runs in a folder, and their records once somebody looks at them."""

    def __init__(self, parent: Path) -> None:
        self.parent = parent
        self._elsewhere: dict[str, Path] = {}
        self._records: dict[str, PastRun] = {}
        self._reading = asyncio.Lock()  # one reader: three requests want the same record at once

    def include(self, folder: Path) -> None:
        """Let the page open a run that may lie elsewhere."""
        self._elsewhere[folder.name] = folder

    def routes(self) -> Sequence[web.RouteDef]:
        """What the page can ask of them."""
        return (
            web.get("/runs.json", self._list),
            web.get("/runs/{name}/page.json", self._page),
            web.get("/runs/{name}/record.json", self._facts),
            web.get("/runs/{name}/record.f32", self._readings),
            web.get("/runs/{name}/map.png", self._map),
            web.get("/runs/{name}/beside/{other}.json", self._compare),
        )

    def folder(self, name: str) -> Path:
        """The folder of a run. Raises RunFolderError if there is no such run."""
        folder = self._elsewhere.get(name, self.parent / name)
        if folder.name != name or name == ".." or not is_run(folder):
            raise RunFolderError(f"no run {name}", "choose one of the list")
        return folder

    async def _record(self, request: web.Request) -> PastRun:
        name = request.match_info["name"]
        async with self._reading:
            if (record := self._records.get(name)) is None:
                try:
                    record = await asyncio.to_thread(PastRun, self.folder(name))
                except ThigmoError as error:
                    raise web.HTTPNotFound(text=str(error)) from error
                self._records[name] = record
                while len(self._records) > _KEPT:
                    del self._records[next(iter(self._records))]
        return record

    async def _list(self, request: web.Request) -> web.Response:
        try:
            listed = await asyncio.to_thread(list_runs, self.parent)
        except DataError:  # nobody has explored yet
            listed = []
        rows: list[dict[str, Any]] = [
            {"run": run.path.name, "problem": run.problem}
            | ({} if run.document is None else {
                "name": run.document.name, "started": run.document.started,
                "url": run.document.url, "effort": run.document.effort,
                "outcome": run.document.outcome, "contacts": len(run.document.contacts),
                "robot_time_s": run.document.robot_time_s, "error_cm": run.document.error_cm,
            })
            for run in reversed(listed)
        ]  # fmt: skip
        return web.json_response({"folder": str(self.parent), "runs": rows})

    async def _page(self, request: web.Request) -> web.Response:
        return web.json_response((await self._record(request)).page())

    async def _facts(self, request: web.Request) -> web.Response:
        facts = await asyncio.to_thread((await self._record(request)).facts)
        return web.Response(body=facts, content_type="application/json")

    async def _readings(self, request: web.Request) -> web.Response:
        readings = await asyncio.to_thread((await self._record(request)).readings)
        return web.Response(body=readings, content_type="application/octet-stream")

    async def _map(self, request: web.Request) -> web.FileResponse:
        try:
            picture = RunFolder(self.folder(request.match_info["name"])).map_path
        except RunFolderError as error:
            raise web.HTTPNotFound(text=str(error)) from error
        if not picture.is_file():
            raise web.HTTPNotFound(text="This run has no map.png.")
        return web.FileResponse(picture)

    async def _compare(self, request: web.Request) -> web.Response:
        try:
            first, second = (
                RunFolder(self.folder(request.match_info[part])).read_document().contacts
                for part in ("name", "other")
            )
        except ThigmoError as error:
            raise web.HTTPNotFound(text=str(error)) from error
        pairs = compare_contacts(first, second, SAME_CONTACT_CM)
        body = [
            {"first": _said(pair.first), "second": _said(pair.second),
             "distance_cm": pair.distance_cm}
            for pair in pairs
        ]  # fmt: skip
        return web.Response(body=json.dumps(body).encode(), content_type="application/json")


def _said(contact: MapContact | None) -> str | None:
    return None if contact is None else f"{contact.place_text}; {contact.certainty_text}"
