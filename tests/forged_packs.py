"""Forged archives of results: one digit or one word of a file altered, and the hashes of the metadata fitted to it."""

import hashlib
import io
import json
import random
import re

import numpy as np
import packed

METADATA = "ro-crate-metadata.json"
NUMBER = re.compile(rb"(?<![\w.])\d+(?:\.\d+)?")
WORD = re.compile(rb"(?<![\w\\#&.])[A-Za-z]{4,}(?![\w;])")
BINARY = (".npz", ".pdf", ".png")
SIGNIFICANT = 7


def forged(content, name, kind, seed=0):
    """Return a content with one digit above the eighth significant one, or one word, altered; None where there is none.

    A binary file gets another number (arrays) or another byte in its middle.  `kind` is digit, word or either.
    """
    draw = random.Random(f"{name} {kind} {seed}")
    kind = draw.choice(["digit", "word"]) if kind == "either" else kind
    if name.endswith(".npz"):
        return _array(content, draw)
    if name.endswith(BINARY):
        place = len(content) // 2
        return content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]
    found = [*(NUMBER if kind == "digit" else WORD).finditer(content)]
    if not found:
        return None
    match = draw.choice(found)
    other = _digit(match[0], draw) if kind == "digit" else _word(match[0])
    return content[: match.start()] + other + content[match.end() :]


def _digit(text, draw):
    places = [place for place, digit in enumerate(text) if chr(digit).isdigit()]
    first = next((number for number, place in enumerate(places) if text[place] != ord("0")), len(places) - 1)
    place = draw.choice(places[first : first + SIGNIFICANT])
    digit = (text[place] - ord("0") + draw.randint(1, 8)) % 10
    return text[:place] + str(digit or 9 - int(text[place : place + 1] == b"9")).encode() + text[place + 1 :]


def _word(text):
    return text[:-1] + (b"x" if text[-1:] != b"x" else b"y")


def _array(content, draw):
    with np.load(io.BytesIO(content)) as file:
        arrays = dict(file)
    name = draw.choice([name for name, array in arrays.items() if array.dtype.kind == "f" and np.any(array)])
    flat = arrays[name].reshape(-1)
    place = draw.choice(np.flatnonzero(np.isfinite(flat) & (flat != 0)).tolist())
    flat[place] *= 1 + 1e-6
    made = io.BytesIO()
    np.savez_compressed(made, **arrays)
    return made.getvalue()


def archive_with(path, to, changes):
    """Copy an archive with other contents, and the metadata that fit them."""
    found = packed.contents(path) | changes
    if METADATA not in changes:
        metadata = json.loads(found[METADATA])
        for entity in metadata["@graph"]:
            if "sha256" in entity:
                entity["sha256"] = hashlib.sha256(found[entity["@id"]]).hexdigest()
                entity["contentSize"] = str(len(found[entity["@id"]]))
        found[METADATA] = (json.dumps(metadata, indent=2, ensure_ascii=False) + "\n").encode()
    return packed.write(to, found)
