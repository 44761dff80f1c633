"""Archives from elsewhere: what is taken out, and what is refused before a byte is written."""

import hashlib
import json
import re
import stat
import struct
import time
import zipfile

import packed
import pytest

from rmpc_bench.received.archive import (
    METADATA,
    ArchiveError,
    note_verification,
    open_archive,
    verifications,
    write_archive,
)
from rmpc_bench.received.consent import VERIFIED

TEXT = b"method,run\nA,0\n"
GRAPH = b'{"@graph": [{"@id": "trials.csv", "sha256": "%s"}]}'
SHA = hashlib.sha256(TEXT).hexdigest()


@pytest.fixture
def good(tmp_path):
    """A small archive, with a description that `write_archive` does not need."""
    path = tmp_path / "good.zip"
    write_archive(path, {"trials.csv": TEXT, METADATA: GRAPH % SHA.encode(), VERIFIED: b"[]\n"})
    return path


def test_equal_contents_give_equal_bytes(good, tmp_path):
    again = tmp_path / "again.zip"
    file = tmp_path / "trials.csv"
    file.write_bytes(TEXT)
    write_archive(again, {VERIFIED: b"[]\n", METADATA: GRAPH % SHA.encode(), "trials.csv": file})
    assert again.read_bytes() == good.read_bytes()
    assert open_archive(good).extract(tmp_path / "x") == ()
    assert (tmp_path / "x" / "trials.csv").read_bytes() == TEXT


def test_changed_missing_and_added_files_are_named(good, tmp_path):
    found = packed.contents(good)
    changed = packed.write(tmp_path / "c.zip", found | {"trials.csv": TEXT + b"A,1\n", "more.txt": b""})
    assert open_archive(changed).extract(tmp_path / "c") == (
        "more.txt: was not packed",
        "trials.csv: its content is not what was packed",
    )
    missing = packed.write(tmp_path / "m.zip", {name: found[name] for name in (METADATA, VERIFIED)})
    assert open_archive(missing).extract(tmp_path / "m") == ("trials.csv: is missing",)


@pytest.mark.parametrize(
    "name",
    [
        *("../evil.txt", "/etc/evil.txt", "a/../../evil.txt", "a\\..\\evil.txt", "C:evil.txt", "a//b", "./a"),
        "d/" * 21 + "a",
        *("line\nfeed", "a\u202eb", "a\u200bb", "\x1b]0;x\x07", "d/" * 260 + "a", "a" * 201, "\u00e9" * 101),
        *(".git", ".git/config", ".GIT/config", "a/.Git/hooks/x", "a/.git", ".git./config", ".git /config", ".git. ."),
        *("git~1/config", "a/GIT~1/config", "GIT~12/x", ".git::$INDEX_ALLOCATION/config", ".g\u200cit/config", ".git/"),
    ],
)
def test_a_name_that_leads_elsewhere_is_refused(good, tmp_path, name):
    path = packed.write(tmp_path / "evil.zip", packed.contents(good) | {name: b"x"})
    with pytest.raises(ArchiveError, match="nothing was taken out"):
        open_archive(path)


def test_a_symbolic_link_is_refused(good, tmp_path):
    path = packed.write(tmp_path / "link.zip", packed.contents(good))
    entry = zipfile.ZipInfo("code")
    entry.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(path, "a") as file:
        file.writestr(entry, "/etc")
    with pytest.raises(ArchiveError, match="is no regular file"):
        open_archive(path)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_entries_of_one_name_are_refused(good):
    with zipfile.ZipFile(good, "a") as file:
        file.writestr("trials.csv", b"other")
    with pytest.raises(ArchiveError, match="two entries of one name"):
        open_archive(good)


def test_a_small_archive_that_would_fill_the_disk_is_refused(good, tmp_path):
    path = packed.write(tmp_path / "bomb.zip", packed.contents(good) | {"zeros.csv": bytes(150_000_000)})
    assert path.stat().st_size < 200_000
    with pytest.raises(ArchiveError, match="would fill 150 MB from 0.1 MB"):
        open_archive(path)


def test_an_entry_is_not_longer_than_it_states(good, tmp_path):
    """The directory of the archive states 10 bytes of an entry that has a million."""
    path = packed.write(tmp_path / "lie.zip", packed.contents(good) | {"zeros.csv": bytes(1_000_000)})
    path.write_bytes(path.read_bytes().replace(struct.pack("<L", 1_000_000), struct.pack("<L", 10)))
    archive = open_archive(path)
    with pytest.raises(ArchiveError, match=r"zeros\.csv"):
        archive.extract(tmp_path / "x")
    assert (tmp_path / "x" / "zeros.csv").stat().st_size <= 10


def test_a_directory_with_content_is_refused(good):
    """It is not taken out, but a verification would copy it."""
    with zipfile.ZipFile(good, "a", zipfile.ZIP_DEFLATED) as file, file.open(zipfile.ZipInfo("d/"), "w") as entry:
        entry.write(bytes(10_000))
    with pytest.raises(ArchiveError, match="'d/' is a directory with content; nothing was taken out"):
        open_archive(good)


def test_an_empty_name_is_refused(good):
    with zipfile.ZipFile(good, "a") as file, file.open(zipfile.ZipInfo(""), "w"):
        pass
    with pytest.raises(ArchiveError, match="the entry '' has a name that .*; nothing was taken out"):
        open_archive(good)


def test_deep_names_are_refused_at_once(tmp_path):
    """The directories above 18,000 names of 240 parts have 1 GB."""
    path = packed.write(tmp_path / "x.zip", {f"{i:05}/" + "d/" * 240: b"" for i in range(18_000)})
    start = time.process_time()
    with pytest.raises(ArchiveError, match="or 20 directories; nothing was taken out"):
        open_archive(path)
    assert time.process_time() - start < 5.0


def test_a_directory_at_another_place(good, tmp_path):
    """Every place that the end of the archive may state is a sentence."""
    content = good.read_bytes()
    place = content.rindex(b"PK\5\6") + 16
    for offset in (0, 1, 100, 2**31, 2**32 - 2):
        (tmp_path / "x.zip").write_bytes(content[:place] + struct.pack("<L", offset) + content[place + 4 :])
        with pytest.raises(ArchiveError):
            open_archive(tmp_path / "x.zip").extract(tmp_path / "x")


def test_a_place_before_the_file(good, tmp_path):
    """An entry at a negative place is an error of the system."""
    content = bytearray(good.read_bytes())
    for entry in re.finditer(b"PK\1\2", content):
        content[entry.start() + 42 : entry.start() + 46] = b"\0\0\0\0"
    (tmp_path / "x.zip").write_bytes(content[50:])
    with pytest.raises(ArchiveError, match="cannot be read|not a zip"):
        open_archive(tmp_path / "x.zip").extract(tmp_path / "x")


def test_a_full_disk_is_not_a_damaged_archive(good, tmp_path):
    """It stays an error of the system."""
    (tmp_path / "x" / METADATA).mkdir(parents=True)
    with pytest.raises(OSError):
        open_archive(good).extract(tmp_path / "x")


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_another_compression_is_refused(good, method):
    """LZMA may ask for gigabytes."""
    with zipfile.ZipFile(good, "a", method) as file:
        file.writestr("more.csv", TEXT)
    with pytest.raises(ArchiveError, match="another method than deflate"):
        open_archive(good)


def test_a_file_that_is_a_directory_too_is_refused(good, tmp_path):
    for names in (("a", "a/b"), ("A", "a/b"), ("a/b/c", "a/B")):
        path = packed.write(tmp_path / "x.zip", packed.contents(good) | dict.fromkeys(names, b""))
        with pytest.raises(ArchiveError, match="is a file and a directory; nothing was taken out"):
            open_archive(path)
    for names in (("Trials.csv",), ("\u00e9", "e\u0301"), ("\u00c9", "e\u0301")):
        path = packed.write(tmp_path / "x.zip", packed.contents(good) | dict.fromkeys(names, b""))
        with pytest.raises(ArchiveError, match="two entries of one name"):
            open_archive(path)


def test_entries_that_share_their_bytes(good, tmp_path):
    """Their stated sizes count, not the bytes that they share."""
    path = packed.write(tmp_path / "x.zip", packed.contents(good) | {f"{i}.csv": bytes(1_000_000) for i in range(120)})
    with zipfile.ZipFile(path) as file:
        first = file.getinfo("0.csv").header_offset
        offsets = [entry.header_offset for entry in file.infolist() if entry.filename[0].isdigit()]
    content = path.read_bytes()
    for offset in offsets[1:]:
        content = content.replace(struct.pack("<L", offset) + b"", struct.pack("<L", first))
    path.write_bytes(content)
    with pytest.raises(ArchiveError, match="would fill 120 MB|cannot be read|not a zip"):
        open_archive(path).extract(tmp_path / "x")


def test_many_entries_are_refused(tmp_path):
    path = packed.write(tmp_path / "x.zip", {str(number): b"" for number in range(20_001)})
    with pytest.raises(ArchiveError, match="has 20001 entries, more than 20000"):
        open_archive(path)


ENTITY = {"@id": "trials.csv", "sha256": SHA}


@pytest.mark.parametrize("name", ["@id", "sha256"])
@pytest.mark.parametrize(
    "value", [None, 3, 1e400, [], {}, "", "../x", "\x1b[2J", ".git/config", True, "a" * 64, "A" * 64]
)
def test_a_field_of_the_metadata_of_another_type(good, tmp_path, name, value):
    """No value but a plain name or a hash is used; the message has no escape of a terminal."""
    text = json.dumps({"@graph": [ENTITY | {name: value}]})
    path = packed.write(tmp_path / "x.zip", packed.contents(good) | {METADATA: text.encode()})
    try:
        open_archive(path)
    except ArchiveError as error:
        assert f"{METADATA}: '{name}'" in str(error) and str(error).isprintable()
    else:
        assert value.lower() == "a" * 64


def test_metadata_of_any_shape_end_in_a_message(good, tmp_path):
    graphs = [None, 3, "x", {}, [], [3, None, "x", []], [ENTITY, ENTITY]]
    texts = [json.dumps({"@graph": each}) for each in graphs] + [
        "[" * 200_000,
        '{"@graph": ' + "[" * 200_000,
        "NaN",
        "\ud800",
    ]
    for text in texts:
        content = text.encode(errors="surrogatepass")
        path = packed.write(tmp_path / "x.zip", packed.contents(good) | {METADATA: content})
        with pytest.raises(ArchiveError, match=METADATA):
            open_archive(path)
    path = packed.write(tmp_path / "x.zip", packed.contents(good) | {METADATA: b" " * 11_000_000})
    with pytest.raises(ArchiveError, match="is larger than 10 MB"):
        open_archive(path)


def test_what_can_execute_is_listed_with_its_hash(tmp_path):
    names = {"a.py": b"x", "data/0/run.csv": b"\x7fELF", "trials.csv": TEXT}
    path = tmp_path / "x.zip"
    write_archive(path, {METADATA: packed.metadata(names), **names})
    archive = open_archive(path)
    archive.extract(tmp_path / "x")
    hashes = {name: hashlib.sha256(names[name]).hexdigest() for name in ("a.py", "data/0/run.csv")}
    assert archive.code(tmp_path / "x") == hashes


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no archive", b"\0" * 1000])
def test_what_is_no_archive_is_said(tmp_path, content):
    path = tmp_path / "x.zip"
    path.write_bytes(content)
    with pytest.raises(ArchiveError, match="is not a zip archive"):
        open_archive(path)


def test_any_damage_ends_in_a_message(good, tmp_path):
    """Every byte in turn is another one; the archive is refused, found changed, or has a byte that does not count."""
    whole = good.read_bytes()
    for place in range(0, len(whole), 7):
        path = tmp_path / "damaged.zip"
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        try:
            open_archive(path).extract(tmp_path / str(place))
        except ArchiveError as error:
            assert "damaged.zip" in str(error)


def test_an_archive_without_hashes_is_refused(tmp_path):
    for metadata in (b"{}", b"[]", b'{"@graph": 3}', b"no JSON"):
        with pytest.raises(ArchiveError, match=METADATA):
            open_archive(packed.write(tmp_path / "x.zip", {METADATA: metadata}))
    with pytest.raises(ArchiveError, match="make archives with `rmpc-bench pack`"):
        open_archive(packed.write(tmp_path / "x.zip", {"a": b""}))


def test_a_name_that_could_not_be_taken_out_is_not_packed(tmp_path):
    with pytest.raises(ArchiveError, match="rename the method or figure"):
        write_archive(tmp_path / "x.zip", {"failures/a:b-1.txt": b""})
    assert not (tmp_path / "x.zip").exists()


def test_verifications_are_appended_and_nothing_else_changes(good):
    before = packed.contents(good)
    note_verification(good, {"result": "reproduced"})
    note_verification(good, {"result": "different"})
    assert [each["result"] for each in verifications(good)] == ["reproduced", "different"]
    after = packed.contents(good)
    assert {name: after[name] for name in after if name != VERIFIED} == {
        name: before[name] for name in before if name != VERIFIED
    }
