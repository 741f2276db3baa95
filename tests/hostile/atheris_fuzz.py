"""Coverage-guided damage: atheris looks for USD that ends in neither a scene nor a SynfogError of one line.

    python tests/hostile/atheris_fuzz.py --seconds 900 --out found

Needs a Python with atheris and this project.  An input is a way to damage the stage of `support.hostile`
(bytes of text, values and types of attributes, cuts and swaps); it is read as `check` and `bake` do.  Inputs
that take the USD library down are read again by the command line, whose child may die where the user gets one
line for it.  What is left is written to the folder as .usda with its trace, and the exit code is 1.
"""

import argparse
import os
import re
import subprocess
import sys
import time
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
ROOT = TESTS.parent
SLOWEST_S = 30
"""An input that takes longer is a finding; with the library instrumented they take some 0.05 s."""
MEMORY_MB = 4096
TRACE = "Uncaught Python exception"
"""What atheris writes before a trace."""


def text_of(data):
    """The .usda text that an input stands for: its first byte says how it is to be understood."""
    from atheris import FuzzedDataProvider
    from support import hostile as at

    if not data or data[0] % 4 == 0:
        return bytes(data[1:])
    take = FuzzedDataProvider(data[1:])
    if data[0] % 4 == 1:
        return at.replaced(
            {
                take.ConsumeIntInRange(0, len(at.VALUES) - 1): _value(take, None)
                for _ in range(take.ConsumeIntInRange(1, 5))
            }
        )
    if data[0] % 4 == 2:
        return at.retyped(
            take.ConsumeIntInRange(0, len(at.VALUES) - 1), at.TYPES[take.ConsumeIntInRange(0, len(at.TYPES) - 1)]
        )
    text = at.TEXT
    for _ in range(take.ConsumeIntInRange(1, 5)):
        begin = take.ConsumeIntInRange(0, max(len(text) - 1, 0))
        piece = text[begin : begin + take.ConsumeIntInRange(0, 400)]
        word = at.WORDS[take.ConsumeIntInRange(0, len(at.WORDS) - 1)]
        put = ("", piece + piece, word, piece[::-1], take.ConsumeUnicodeNoSurrogates(8))[take.ConsumeIntInRange(0, 4)]
        text = text[:begin] + put + text[begin + len(piece) :]
    return text


def _value(take, kind):
    """A value of the type of some attribute, one in eight of another's."""
    from support import hostile as at

    kind = kind or at.type_of(take.ConsumeIntInRange(0, len(at.VALUES) - 1))
    if kind.endswith("[]"):
        return f"[{', '.join(_value(take, kind[:-2]) for _ in range(take.ConsumeIntInRange(0, 6)))}]"
    words, sizes = at.parts_of(kind)

    def part(left):
        if not left:
            return words[take.ConsumeIntInRange(0, len(words) - 1)]
        return f"({', '.join(part(left[1:]) for _ in range(left[0]))})"

    return part(sizes)


def drive(arguments):
    """Within the child: libFuzzer's loop."""
    import atheris

    with atheris.instrument_imports(include=["synfog_usd.stage", "synfog_usd.translate", "synfog_usd.fog"]):
        from support import hostile

    atheris.Setup([sys.argv[0], *arguments], lambda data: hostile.read(text_of(data)) and None)
    atheris.Fuzz()


def hunt(seconds, out):
    """Run the loop again and again until the time is over; (cases, deaths of the library that the command line tells in
    one line, findings).
    """
    from support import hostile

    corpus, artefacts = out / "corpus", out / "artefacts"
    for folder in (corpus, artefacts):
        folder.mkdir(parents=True, exist_ok=True)
    (corpus / "sound").write_bytes(b"\0" + hostile.TEXT.encode())
    for number in range(64):
        (corpus / f"seed{number}").write_bytes(
            bytes([1 + number % 3]) + bytes((number * 37 + 11 * k) % 256 for k in range(96))
        )
    words = out / "words.dict"
    words.write_text(
        "".join(f'"{word}"\n' for word in hostile.WORDS if re.fullmatch(r"[\w:.]{2,}", word)), encoding="ascii"
    )
    cases, deaths, findings, end, turn = 0, 0, [], time.monotonic() + seconds, 0
    while (left := end - time.monotonic()) > 3:
        turn += 1
        options = (
            f"-max_total_time={int(left)}",
            f"-seed={turn}",
            f"-timeout={SLOWEST_S}",
            f"-rss_limit_mb={MEMORY_MB}",
            "-max_len=32768",
            "-len_control=0",
        )
        command = [
            sys.executable,
            __file__,
            "--drive",
            *options,
            f"-dict={words}",
            f"-artifact_prefix={artefacts}/",
            "-print_final_stats=1",
            corpus,
        ]
        together = {
            "stdout": subprocess.PIPE,
            "stderr": subprocess.STDOUT,
        }  # traces come on the one, figures on the other
        done = subprocess.run([*map(str, command)], **together, text=True, errors="replace", env=_environment())
        told = done.stdout
        counted = re.findall(r"stat::number_of_executed_units:\s+(\d+)", told) or re.findall(
            r"^#(\d+)", told, re.MULTILINE
        )
        cases += int(counted[-1]) if counted else 0
        if done.returncode == 0:
            continue
        inputs = [Path(name) for name in re.findall(r"Test unit written to (\S+)", told)]
        if not inputs:
            raise SystemExit(f"atheris ended with {done.returncode} and no input:\n{told[-3000:]}")
        trace = told[told.find(TRACE) :] if TRACE in told else _of_command_line(inputs[-1], out)
        if trace is None:
            deaths += 1
            continue
        kept = out / f"finding{len(findings)}.usda"
        text = text_of(inputs[-1].read_bytes())
        kept.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
        kept.with_suffix(".txt").write_text(trace[:6000], encoding="utf-8")
        findings.append(kept)
    return cases, deaths, findings


def _of_command_line(data, out):
    """What is wrong with how `check` ends on an input that ended its reader; None where that is well."""
    from support import hostile

    path = out / "died" / f"{data.name}.usda"
    path.parent.mkdir(exist_ok=True)
    text = text_of(data.read_bytes())
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
    hostile.furnish(path.parent)
    command = [sys.executable, "-m", "synfog_usd.cli.main", "check", str(path)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=4 * SLOWEST_S, env=_environment())
    except subprocess.TimeoutExpired:
        return f"check takes more than {4 * SLOWEST_S} s"
    well = done.returncode in (0, 1, 2) and "Traceback" not in done.stderr and done.stderr.count("\n") <= 1
    return None if well else f"exit code {done.returncode}\n{done.stderr}"


def _environment():
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS), str(ROOT), os.environ.get("PYTHONPATH", "")])}


def main():
    """One line of figures; exit code 1 where something was found."""
    if "--drive" in sys.argv:
        drive(sys.argv[sys.argv.index("--drive") + 1 :])
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    sys.path.insert(0, str(TESTS))
    cases, deaths, findings = hunt(asked.seconds, asked.out)
    print(f"{cases} cases, {deaths} deaths of the USD library that are one line to the user, {len(findings)} findings")
    for one in findings:
        print(one)
    raise SystemExit(1 if findings else 0)


if __name__ == "__main__":
    main()
