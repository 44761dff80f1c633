"""docs/security.md: short, found from SECURITY.md."""

from pathlib import Path

from rmpc_bench.packing.comparison import BYTES, HASHED, NUMBERS, UNSEEN

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")


def test_it_is_short_and_linked():
    """A page that nobody finds or finishes protects nobody."""
    assert len(PAGE.split()) <= 600
    assert "(SECURITY.md)" in (ROOT / "README.md").read_text(encoding="utf-8")
    assert "(docs/security.md)" in (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    assert "(security.md)" in (ROOT / "docs" / "experiments.md").read_text(encoding="utf-8")


def test_it_says_what_verify_does_not_compare():
    """A hash in an archive can be computed again by whoever has altered a file."""
    assert "what is only hashed" in PAGE and '"Reproduced" covers the first two only' in PAGE
    assert all(f"| {word} |" in PAGE for word in (BYTES, NUMBERS, HASHED, UNSEEN))
