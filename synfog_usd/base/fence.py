"""The fence: which files a stage may reach.

Takes the stage's file and folders that its user allows; says of a path whether it
lies inside, by its real path, so that links lead nowhere else.  Knows nothing of USD.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from synfog_usd.base import resources
from synfog_usd.base.errors import StageError

LAYERS = (".usd", ".usda", ".usdc", ".usdz")
"""Ends of the names of files that are read as scene description."""


@dataclass(frozen=True)
class Fence:
    """Folders in and below which a stage finds its files.

    Attributes:
        folders: real paths; the first is the stage's own.
    """

    folders: tuple[Path, ...]

    @classmethod
    def around(cls, stage: Path, allow: Iterable[str | Path] = ()) -> Fence:
        """The stage's folder, the allowed ones, and the assets that ship with the package.

        Raises:
            StageError: an allowed folder that is none.
        """
        allowed = [Path(folder) for folder in allow]
        for folder in allowed:
            if not folder.is_dir():
                raise StageError(f"--allow {folder}: no such folder")
        shipped = [resources.folder("assets"), resources.folder("stages")]
        return cls(
            tuple(dict.fromkeys(Path(os.path.realpath(folder)) for folder in [stage.parent, *allowed, *shipped]))
        )

    def fault(self, file: str | Path) -> str | None:
        """Why a file is refused, with the way out; None where it lies inside."""
        path = Path(file)
        if not self.folders:
            return f"{path} belongs to a stage that has no file, and so no folder; save the stage"
        real = Path(
            os.path.realpath(path)
        )  # where resolve() fails on a link to itself, which is a file that is not there
        if not any(_inside(real, folder) for folder in self.folders):
            link = f" (a link to {real})" if real != Path(os.path.abspath(path)) else ""  # noqa: PTH100 - without following links
            return (
                f"{path}{link} lies outside of the stage's folder {self.folders[0]}; copy it there, or allow its "
                f"folder with --allow {self._shared(real)}"
            )
        if path.exists() and not path.is_file():
            return f"{path} is no regular file; a stage is made of files only"
        return None

    def _shared(self, real: Path) -> Path:
        """The folder to allow: what the stage and the file have in common where that is near, as an asset library's
        root is.
        """
        try:
            common = Path(os.path.commonpath([real, self.folders[0]]))
        except ValueError:  # on another drive
            return real.parent
        return common if len(self.folders[0].relative_to(common).parts) <= 3 and len(common.parts) > 3 else real.parent


def _inside(real: Path, folder: Path) -> bool:
    """Whether a path lies in a folder or below it, by name or, where case does not count, by the folders themselves."""
    if real.is_relative_to(folder):
        return True
    return any(_same(above, folder) for above in real.parents if above.name.casefold() == folder.name.casefold())


def _same(path: Path, reference: Path) -> bool:
    try:
        return path.samefile(reference)
    except OSError:
        return False
