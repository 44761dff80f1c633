"""Configurations that somebody has made to harm the reader: files of numbers, code, and texts that grow.

Each is read by `check` and `run -n`; those with data or code are packed, too.
"""

import io
import pickle
import struct
import zipfile
import zlib

import numpy as np
import pytest
import small_experiment
from received.box import Case, Command, check, verify
from received.hostile_archives import archive

LINEAR = {
    "uncertainty": None,
    "plant": "{kind: linear, A: {file: FILE, name: A}, B: [[1]], C: [[1]]}",
    "model": "{from: plant}",
    "controller": None,
    "methods": "{KF: {estimator: {kind: kalman}}}",
}
"""A plant with a matrix from a file."""


class _Evil:
    def __init__(self, command):
        self.command = command

    def __reduce__(self):
        import os

        return os.system, (self.command,)


def pickled(box):
    """A pickle that starts a command when it is read."""
    return pickle.dumps(_Evil(box.shell))


def with_matrix(box, name, content):
    """Write a file of numbers and a configuration with a matrix of it."""
    (box.here / name).write_bytes(content)
    keys = LINEAR | {"plant": LINEAR["plant"].replace("FILE", name)}
    if name.endswith(".csv"):
        keys["plant"] = keys["plant"].replace(", name: A", "")
    return small_experiment.write(box.here, **keys)


def npz(content, name="A.npy"):
    """An archive of NumPy with one entry."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(name, content)
    return stream.getvalue()


def _header(shape, kind="<f8"):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": kind, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def _evaluated(box):
    """A header whose text is a program."""
    text = f"(__import__('os').system({box.shell!r}),)".encode().ljust(4096)
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def _mat_bomb(box):
    inside = struct.pack("<2I", 14, 1 << 30) + bytes(64_000_000)
    packed = zlib.compress(inside, 9)
    return b"MATLAB 5.0".ljust(124) + struct.pack("<H", 0x100) + b"IM" + struct.pack("<2I", 15, len(packed)) + packed


def _mat_object(box):
    """An object of MATLAB, of which the reader of SciPy makes anything it names."""
    inside = struct.pack("<2I", 6, 8) + struct.pack("<2I", 17, 0) + struct.pack("<2I", 1, 8) + b"function"
    return b"MATLAB 5.0".ljust(124) + struct.pack("<H", 0x100) + b"IM" + struct.pack("<2I", 14, len(inside)) + inside


MATRICES = {
    "pickle-objects.npz": lambda box: npz(_header((1,), "|O") + pickled(box)),
    "pickle-entry.npz": lambda box: npz(pickled(box)),
    "pickle-file.npz": pickled,
    "pickle-file.mat": pickled,
    "pickle-file.csv": pickled,
    "pickle-npy.npz": lambda box: _header((1,), "|O") + pickled(box),
    "pickle-object.mat": _mat_object,
    "pickle-header.npz": lambda box: npz(_evaluated(box)),
    "bomb-header.npz": lambda box: npz(_header((1_000_000, 1_000_000))),
    "bomb-deflate.npz": lambda box: npz(_header((900_000_000,), "|u1") + bytes(900_000_000)),
    "bomb-negative.npz": lambda box: npz(_header((-1, -1)) + bytes(8)),
    "bomb-overflow.npz": lambda box: npz(_header((2**40, 2**40)) + bytes(8)),
    "bomb-zlib.mat": _mat_bomb,
    "bomb-wide.csv": lambda box: b"1," * 3_000_000 + b"1",
    "bomb-tall.csv": lambda box: b"1\n" * 4_900_000,
    "bomb-number.csv": lambda box: b"1" * 9_000_000,
    "bomb-quote.csv": lambda box: b'"' + b"1" * 9_000_000,
}


def _matrix(name, make):
    def cases(box):
        file = name.partition("-")[2]
        yield from check(with_matrix(box, file, make(box)), refused=True)

    return cases


RECORDED = """
version: 1
name: recorded
runs: 2
time: {step: 0.1, steps: 5}
plant: {data: FILE, columns: {y: y}}
model: {kind: linear, A: [[1]], B: [[1]], C: [[1]], P_w: 1, P_v: 1}
initial: {x_hat: 0, P: 1}
methods: {KF: {estimator: {kind: kalman}}}
metrics: [estimation_mse]
"""


def _recorded(file, make):
    """A recording, which is read when the plant is made."""

    def cases(box):
        (box.here / file).write_bytes(make(box))
        config = box.here / "recorded.yaml"
        config.write_text(RECORDED.replace("FILE", file), encoding="utf-8")
        yield from check(config, refused=True)

    return cases


RECORDINGS = {
    "pickle": ("y.npz", lambda box: npz(_header((5,), "|O") + pickled(box), "y.npy")),
    "wide": ("y.csv", lambda box: b"y," * 3_000_000 + b"y\n1\n"),
    "header": ("y.npz", lambda box: npz(_header((2**34,)), "y.npy")),
}


def _text(make, *, refused=True):
    def cases(box):
        path = box.here / "x.yaml"
        path.write_bytes(make(box) if isinstance(make(box), bytes) else make(box).encode())
        yield from check(path, refused=refused)
        changes = {"config.resolved.yaml": path.read_bytes(), "config.yaml": path.read_bytes()}
        yield from verify(archive(box, changes), note="packed")

    return cases


def _aliases(box):
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 10)]
    return "\n".join(lines) + "\n" + small_experiment.text(title="*a9")


TEXTS = {
    "bomb-aliases": _aliases,
    "bomb-deep": lambda box: small_experiment.text(figures="[" * 100_000),
    "bomb-deep-block": lambda box: "a:\n" + "".join(" " * n + "- \n" for n in range(2000)),
    "bomb-size": lambda box: small_experiment.text() + "# " + "x" * 50_000_000,
    "bomb-merge": lambda box: small_experiment.text(title="&t {<<: [*t, *t]}"),
    "bomb-runs": lambda box: small_experiment.text(runs="1" + "0" * 400),
    "bomb-digits": lambda box: small_experiment.text(seed="9" * 100_000),
    "bomb-sweep": lambda box: small_experiment.text(sweep="{seed: {from: 0, to: 1000000000, n: 1000000000}}"),
    "bomb-expression": lambda box: small_experiment.text(uncertainty="{eps: 9**9**9**9**9}"),
    "bomb-expression-deep": lambda box: small_experiment.text(
        plant="{kind: servo-linear, perturb: {J_l: '" + "(" * 50_000 + "}"
    ),
    "pickle-tag": lambda box: small_experiment.text(title=f"!!python/object/apply:os.system ['{box.shell}']"),
    "pickle-name-tag": lambda box: small_experiment.text(title="!!python/name:os.system"),
    "pickle-new-tag": lambda box: small_experiment.text(title="!!python/object/new:subprocess.Popen [[touch, x]]"),
    "text-nul": lambda box: small_experiment.text(title='"a\\0b"'),
    "text-utf16": lambda box: small_experiment.text().encode("utf-16"),
    "text-surrogate": lambda box: small_experiment.text(title='"\\uD800"'),
    "name-escape": lambda box: small_experiment.text(name='"\\e]0;pwn\\a"'),
    "name-direction": lambda box: small_experiment.text(methods='{"S\\u202Ex": {estimator: {kind: kalman}}}'),
    "name-parent": lambda box: small_experiment.text(name="../../../ESC"),
    "name-absolute": lambda box: small_experiment.text(name=str(box.outside / "ESC")),
    "paper-parent": lambda box: small_experiment.text(paper="../../ESC"),
    "extends-outside": lambda box: small_experiment.text(extends=str(box.outside / "precious")),
    "extends-itself": lambda box: small_experiment.text(extends="x.yaml"),
    "extends-device": lambda box: small_experiment.text(extends="/dev/zero"),
}
UNSURE = {"bomb-runs", "bomb-size", "bomb-merge", "text-utf16"}
"""Texts that may be accepted."""


def unit(box, name="t.fmu"):
    """A unit for co-simulation whose library is text, so that it only counts whether somebody loads it."""
    adapters = pytest.importorskip("adapters.fmu_units")
    path = box.here / name
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("modelDescription.xml", adapters.description(2))
        for place in ("linux64", "darwin64", "win64"):
            file.writestr(f"binaries/{place}/tanks.{'so' if place == 'linux64' else 'dylib'}", b"\x7fELF")
    return path


FMU = {
    "uncertainty": None,
    "plant": "{fmu: FILE, states: [h1, h2], inputs: [pump], outputs: [level], parameters: {a1: 7.1e-6, a2: 6.3e-6}}",
    "model": "{kind: linear, A: [[0.95, 0], [0.05, 0.95]], B: [[1e-3], [0]], C: [[0, 1]], P_w: 1e-6, P_v: 1e-6}",
    "initial": "{x: [0.2, 0.1], x_hat: [0.2, 0.1], P: 1e-4}",
    "controller": None,
    "methods": "{KF: {estimator: {kind: kalman}}}",
    "reference": None,
    "metrics": "[estimation_mse]",
}
NO_CODE = {"RMPC_BENCH_NO_CODE": "1"}


def fmu_config(box, file):
    """A configuration with a unit as its plant."""
    return small_experiment.write(box.here, **FMU | {"plant": FMU["plant"].replace("FILE", str(file))})


def _fmu_packed(name, environ):
    def cases(box):
        found = unit(box, name).read_bytes()
        text = small_experiment.text(**FMU | {"plant": FMU["plant"].replace("FILE", f"data/0/{name}")}).encode()
        (box.here / name).unlink()
        changes = {f"data/0/{name}": found, "config.resolved.yaml": text, "config.yaml": text}
        yield from verify(archive(box, changes), environ=environ)

    return cases


def _fmu_elsewhere(box):
    path = unit(box)
    there = path.rename(box.outside / "elsewhere" / "t.fmu")
    yield from check(fmu_config(box, there), refused=True)
    yield from check(fmu_config(box, "../outside/elsewhere/t.fmu"), refused=True)


def _fmu_forbidden(box):
    yield from check(fmu_config(box, unit(box).name), refused=True, environ=NO_CODE)
    yield from check(fmu_config(box, unit(box, "t.dat").name), refused=True, environ=NO_CODE)


ESTIMATOR = "{S-MPC: {estimator: {file: 'PATH:Own'}}}"


def _python_outside(box):
    (box.outside / "elsewhere" / "evil.py").write_text(box.python, encoding="utf-8")
    for path in ("../outside/elsewhere/evil.py", box.outside / "elsewhere" / "evil.py"):
        yield from check(
            small_experiment.write(box.here, methods=ESTIMATOR.replace("PATH", str(path))), refused=True, note=str(path)
        )
    (box.here / "link.py").symlink_to(box.outside / "elsewhere" / "evil.py")
    yield from check(small_experiment.write(box.here, methods=ESTIMATOR.replace("PATH", "link.py")), refused=True)
    (box.here / "folder").symlink_to(box.outside / "elsewhere")
    config = small_experiment.write(box.here, methods=ESTIMATOR.replace("PATH", "folder/evil.py"))
    yield from check(config, refused=True)
    yield from check(small_experiment.write(box.here, plugins=["../outside/elsewhere/evil.py"]), refused=True)


def _python_forbidden(box):
    (box.here / "evil.py").write_text(box.python, encoding="utf-8")
    for keys in ({"methods": ESTIMATOR.replace("PATH", "evil.py")}, {"plugins": "[evil.py]"}):
        yield from check(small_experiment.write(box.here, **keys), refused=True, environ=NO_CODE)


def _python_packed(box):
    """The own component of an honest archive is another program; nobody has agreed to either."""
    name = next(each for each in zipfile.ZipFile(box.honest.archive("owned")).namelist() if each.endswith(".py"))
    path = archive(box, {name: box.python.encode()}, base="owned")
    yield from verify(path)[1:]
    yield from verify(path, environ=NO_CODE)[1:]
    yield verify(path)[0]


MODULES = (
    "this:Foo-v0",
    "evil:Foo-v0",
    "rmpc_bench.__main__:Foo-v0",
    "evil.inner:Foo-v0",
    "os:Foo-v0",
    "antigravity:x-v0",
)


def _environment(box):
    """Gymnasium imports the part before the colon."""
    (box.here / "evil.py").write_text(box.python, encoding="utf-8")
    keys = {"uncertainty": None, "controller": None, "methods": "{KF: {estimator: {kind: kalman}}}"}
    for text in MODULES:
        plant = f"{{env: '{text}', state: state}}"
        for environ in ({}, {"PYTHONPATH": str(box.here)}):
            yield from check(
                small_experiment.write(box.here, plant=plant, **keys), refused=True, environ=environ, note=text
            )


LYING = (
    *("sitecustomize.py", "usercustomize.py", "conftest.py", "numpy.py", "json.py", "rmpc_bench.py", "evil.pth"),
    *("rmpc_bench/__init__.py", "setup.py", "__init__.py", "__main__.py", "scipy/__init__.py", "pyproject.toml"),
    *("matplotlibrc", ".numba_config.yaml", "gymnasium.py", "fmpy/__init__.py", "rocrate/__init__.py"),
)
"""Files that Python or a library takes from the current directory."""


def lay(box, place):
    """Write such files, each a program that leaves a mark, and compiled code of numba that is a pickle."""
    for name in LYING:
        path = place / name
        path.parent.mkdir(parents=True, exist_ok=True)
        text = {"matplotlibrc": "backend: module://evil\n", ".numba_config.yaml": "debug: 1\n"}.get(name, box.python)
        path.write_text(f"import os; {text}" if name.endswith(".pth") else text, encoding="utf-8")
    cache = place / "__pycache__"
    cache.mkdir(exist_ok=True)
    for name in ("kernel-1.py311.nbi", "kernel-1.py311.1.nbc", "numpy.cpython-311.pyc", "json.cpython-311.pyc"):
        (cache / name).write_bytes(pickled(box))


def _lying_beside(box):
    lay(box, box.here)
    config = small_experiment.write(box.here)
    yield from check(config)
    yield Command(("run", config, "-o", "out", "-j", 2, "--no-report", "--progress", "none"), (box.here / "out",), (0,))


def _lying_packed(box):
    lay(box, box.here)
    names = [path for path in box.here.rglob("*") if path.is_file()]
    found = {path.relative_to(box.here).as_posix(): path.read_bytes() for path in names}
    yield from verify(archive(box, found))


CODE = {
    "fmu-packed": _fmu_packed("t.fmu", {}),
    "fmu-packed-forbidden": _fmu_packed("t.fmu", NO_CODE),
    "fmu-packed-other-name": _fmu_packed("t.csv", {}),
    "fmu-elsewhere": _fmu_elsewhere,
    "fmu-forbidden": _fmu_forbidden,
    "python-outside": _python_outside,
    "python-forbidden": _python_forbidden,
    "python-packed": _python_packed,
    "environment": _environment,
    "lying-beside": _lying_beside,
    "lying-packed": _lying_packed,
}
CASES = [
    *(Case("config-numbers", name, _matrix(name, make)) for name, make in MATRICES.items()),
    *(Case("config-numbers", f"recorded-{name}", _recorded(*each)) for name, each in RECORDINGS.items()),
    *(Case("config-text", name, _text(make, refused=name not in UNSURE)) for name, make in TEXTS.items()),
    *(Case("config-code", name, make) for name, make in CODE.items()),
]
