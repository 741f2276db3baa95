"""The manifest of a bake while it grows."""

import json

from synfog_usd import files
from synfog_usd.dataset import ledger
from synfog_usd.dataset.plan import Shot


def test_a_manifest_of_very_many_quick_shots_is_written_less_often_and_ends_whole(tmp_path, monkeypatch):
    """Each of the first hundred at once, the rest once in ten times as long as writing takes, and at the end."""
    written, write = [], files.write_json

    def counted(path, content):
        written.append(len(content["shots"]))
        write(path, content)

    monkeypatch.setattr(files, "write_json", counted)
    shots = tuple(Shot("noon", f"fog{n}", "noon", f"fog{n}") for n in range(ledger.MANY + 200))
    kept = ledger.Ledger(tmp_path, {"seed": 1}, ())
    for shot in shots:
        kept.add(shot, {"folder": shot.folder, "files": {}})
    assert written[: ledger.MANY] == list(range(1, ledger.MANY + 1))
    assert len(written) < ledger.MANY + 100
    kept.finish(shots, {})
    assert len(json.loads((tmp_path / ledger.MANIFEST).read_bytes())["shots"]) == len(shots)
    again = ledger.Ledger(tmp_path, {"seed": 1}, ())
    assert all(again.done(shot) for shot in shots)
