"""What is closed when its `with` block ends: connections, records, servers."""

from __future__ import annotations

from typing import Self


class Closing:
    """Something that a `with` statement closes."""

    def close(self) -> None:
        """Release its resources; may be called twice."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
