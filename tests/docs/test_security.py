"""docs/security.md: short, found from the README, with the words that `verify` uses."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")


def test_it_is_short_and_linked():
    """A page that nobody finds or finishes protects nobody."""
    assert len(PAGE.split()) <= 600
    assert "(docs/security.md)" in (ROOT / "README.md").read_text(encoding="utf-8")
    assert "(security.md)" in (ROOT / "docs" / "experiments.md").read_text(encoding="utf-8")


def test_the_words_of_verify():
    """Each has its row."""
    for words in ("compared, equal bytes", "compared, equal to 1e-9", "only hashed", "not looked at"):
        assert f"| {words} |" in PAGE
