"""What the bytes of a set depend on: its definition, the files that it draws from, and what makes it.

A folder holds one set, made by one program from one library of models.  Whoever goes on with it, on whichever
machine, is held to that: `mismatch` tells in which points another would differ.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from synfog_usd.base import files, resources
from synfog_usd.base.errors import SetError
from synfog_usd.base.numbers import QUALITIES, STANDARD
from synfog_usd.dataset.sets import layout
from synfog_usd.dataset.sets.definition import SetDefinition

FREE = ("about", "scenes")
"""Sections by which a set may grow: they change nothing of the scenes that are there."""


class MismatchError(SetError):
    """What is here would make another set than the one that lies there."""


def identity(definition: SetDefinition, variant: str) -> dict[str, Any]:
    """What `set.json` says of what a set is made from.

    Args:
        definition: the set.
        variant: Mitsuba's, see `render.backend`.
    """
    from synfog_usd import camera
    from synfog_usd.dataset.ledger import library_versions

    recipes = {source.name: files.sha256_of(source.recipe) for source in definition.sources if source.recipe}
    return {
        "definition": {key: value for key, value in definition.words.items() if key not in FREE},
        "recipes": recipes,
        "stages": {
            source.name: {path.name: files.sha256_of(path) for path in source.stages}
            for source in definition.sources
            if source.stages
        },
        "pipelines": {path.stem: camera.load_graph(path).hash for path in definition.pipelines},
        "assets": assets_hash() if recipes else None,
        "variant": variant,
        "versions": library_versions(denoise=QUALITIES[definition.quality.get("quality", STANDARD)].clean),
    }


def assets_hash(folder: Path | None = None) -> str:
    """One hash of all that recipes place: models, skies, lamps and textures."""
    folder = folder or resources.folder("assets")
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder)
        if path.is_file() and inside.parts[0] != "builders" and "__pycache__" not in inside.parts:
            digest.update(f"{inside.as_posix()}\0{files.sha256_of(path)}\n".encode())
    return digest.hexdigest()


def read(out: Path) -> dict[str, Any]:
    """What `set.json` of a folder says.

    Raises:
        SetError: no set lies there, or a damaged one.
    """
    path = out / layout.SET
    try:
        content = json.loads(path.read_bytes())
        if content["schema"] != "synfog-usd/set" or content["version"] != 1:
            raise SetError(
                f"{path}: schema {content['schema']!r} {content['version']}; this program reads synfog-usd/set 1"
            )
        content["made_of"], content["name"], content["scenes"]
    except FileNotFoundError as error:
        raise SetError(f"{out}: holds no set ({layout.SET}); make one with synfog-usd dataset run") from error
    except OSError as error:
        raise SetError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError) as error:
        raise SetError(
            f"{path}: damaged ({error}); delete it, and dataset run writes it again if all else is the same"
        ) from error
    return dict(content)


def write(out: Path, definition: SetDefinition, made_of: Mapping[str, Any]) -> None:
    """Say in `set.json` what the set is."""
    plain = {"schema": "synfog-usd/set", "version": 1, "name": definition.name, "about": definition.about}
    files.write_json(out / layout.SET, {**plain, "scenes": definition.scenes, "made_of": made_of})


def check(out: Path, made_of: Mapping[str, Any]) -> None:
    """Refuse to go on with a set that something else made.

    Raises:
        MismatchError: with the points in which they differ.
    """
    differences = list(mismatch(read(out)["made_of"], json.loads(json.dumps(made_of))))
    if differences:
        raise MismatchError(
            f"{out}: holds a set that was made of something else; another folder keeps the two apart. It differs in "
            + "; ".join(differences)
        )


def mismatch(there: object, here: object, what: str = "") -> Iterator[str]:
    """In which points two identities differ, in words."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted({*there, *here}):
            yield from mismatch(there.get(key), here.get(key), f"{what}.{key}" if what else key)
    elif there != here:
        yield f"{what} (there {_short(there)}, here {_short(here)})"


def _short(value: object) -> str:
    text = "nothing" if value is None else json.dumps(value)
    return text if len(text) <= 40 else f"{text[:12]}...{text[-4:]}"
