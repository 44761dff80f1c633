"""Configurations with random mistakes: a message or a plan of the run, never a traceback or an internal error."""

import random
import re
from pathlib import Path

import pytest
from small_experiment import cli

CONFIGS = Path(__file__).parents[2] / "configs"
FILES = (
    "quickstart.yaml",
    "belda2017/exp1.yaml",
    "souto2011/fig2.yaml",
    "ma2025/fig4.yaml",
    "benchmarks/wang2021.yaml",
)
WORDS = (
    *("null", "[]", "{}", "~", "''", "-1", "0", "1e400", ".nan", "-.inf", "1/0", "1" * 400, "2**9999", "true", "0x1F"),
    *("[[1, 2], [3]]", "[1, [2]]", "{a: 1}", "&a [*a]", "*a", "!!python/object:os.system x", "<<", "\u0000", "\ud7ff"),
    *("[" * 300, "{kind: servo}", "{kind: }", "{file: x.csv}", "{file: .}", "x" * 300, "pi(", "1 + eps_none", "100%"),
    *("1e308", "5e-324", "-1e-3", "all", "none", "same", "2020-01-01", "../..", "!delete", "é", "\t", "[nan, nan]"),
)


def mutated(text, rng):
    """Return a text with one to three mistakes."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        lines = text.splitlines(keepends=True)
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        at = rng.randrange(len(text))
        kind = rng.randrange(7)
        if kind == 0:
            del lines[i]
        elif kind == 1:
            lines.insert(j, lines[i])
        elif kind == 2:
            lines[i], lines[j] = lines[j], lines[i]
        elif kind == 3:
            lines[i] = rng.choice((" ", "  ", "- ", "")) + lines[i].lstrip()
        elif kind == 4:
            lines = [text[:at] + rng.choice("{}[]:,#&*!|>'\"%@`\\ \n-?") + text[at + rng.randrange(2) :]]
        else:
            # A value or a key becomes another word.
            parts = re.split(r"([\s,:{}\[\]]+)", lines[i])
            places = [place for place, part in enumerate(parts) if part.strip(" ,:{}[]\n")]
            if places:
                parts[rng.choice(places)] = rng.choice(WORDS)
            lines[i] = "".join(parts)
        text = "".join(lines) or "\n"
    return text


@pytest.mark.parametrize("n", [pytest.param(150, marks=pytest.mark.long), pytest.param(1500, marks=pytest.mark.slow)])
def test_random_mistakes(tmp_path, n):
    """Whatever is wrong, `run --dry-run` ends with 0 or 2, and with words on stderr if it is 2."""
    rng = random.Random(n)
    path = tmp_path / "configs" / "x" / "mutated.yaml"
    path.parent.mkdir(parents=True)
    (tmp_path / "configs" / "benchmarks").symlink_to(CONFIGS / "benchmarks")
    for number in range(n):
        text = mutated((CONFIGS / FILES[number % len(FILES)]).read_text(encoding="utf-8"), rng)
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
        result = cli("run", path, "-o", tmp_path / "out", "--dry-run")
        kept = tmp_path / f"{number}.yaml"
        if result.exit_code not in (0, 2) or "Traceback" in result.output or (result.exit_code and not result.stderr):
            kept.write_bytes(path.read_bytes())
        assert not kept.exists(), f"{kept}: exit {result.exit_code}: {result.exception!r}\n{result.output[-3000:]}"
