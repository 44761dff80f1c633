"""Files of results are replaced as a whole and never written through a symbolic link."""

import pytest

from rmpc_bench.replaced_file import folder, inside, replace_text, replaced


def test_an_earlier_file_stays_when_writing_fails(tmp_path):
    file = tmp_path / "summary.csv"
    replace_text(file, "before\n")
    with pytest.raises(ZeroDivisionError), replaced(file) as partial:
        partial.write_text("half", encoding="utf-8")
        raise ZeroDivisionError
    assert file.read_text(encoding="utf-8") == "before\n"
    assert [path.name for path in tmp_path.iterdir()] == ["summary.csv"]


def test_the_target_of_a_symbolic_link_is_not_touched(tmp_path):
    other = tmp_path / "other.txt"
    other.write_text("mine\n", encoding="utf-8")
    link = tmp_path / "report.html"
    link.symlink_to(other)
    replace_text(link, "page\n")
    assert other.read_text(encoding="utf-8") == "mine\n"
    assert not link.is_symlink()
    assert link.read_text(encoding="utf-8") == "page\n"


def test_a_directory_that_is_a_symbolic_link_is_refused(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "figures").symlink_to(tmp_path / "elsewhere", target_is_directory=True)
    with pytest.raises(OSError, match="figures is a symbolic link; replace it by a directory"):
        folder(tmp_path, "figures")
    assert folder(tmp_path / "new", "tables").is_dir()


@pytest.mark.parametrize("name", ["../a", "../../a", "link/a", "link/../a", "b/../../a"])
def test_nothing_outside_of_a_named_directory(tmp_path, name):
    """Whatever a name is made of, links resolved; one named directory inside another counts with it."""
    top, elsewhere = tmp_path / "top", tmp_path / "elsewhere"
    (top / "b").mkdir(parents=True)
    elsewhere.mkdir()
    (top / "link").symlink_to(elsewhere)
    with inside(top), pytest.raises(OSError, match="lies outside of"):
        replace_text(top / name, "x")
    with inside(top), pytest.raises(OSError, match="lies outside of"), inside((top / name).parent):
        pass
    with inside(top), pytest.raises(OSError, match="lies outside of|is a symbolic link"):
        folder(top / name, "c")
    assert not [*elsewhere.iterdir()] and {path.name for path in tmp_path.iterdir()} == {"top", "elsewhere"}
    with inside(top):
        replace_text(top / "b" / "a", "x")
    replace_text(tmp_path / "a", "x")
