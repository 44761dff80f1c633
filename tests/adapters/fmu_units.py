"""Co-simulation units of the two tanks for tests, compiled with gcc."""

import subprocess
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("fmpy")

import fmpy
import fmpy.fmi2
import fmpy.fmi3

SOURCES = Path(__file__).parent / "fmu_sources"
NAMES = {"states": {"h1": "m", "h2": "m"}, "inputs": {"pump": "ml/s"}, "outputs": {"level": "m"}}
_VARIABLES = (
    # name, causality, variability, initial, start
    ("h1", "local", "continuous", "exact", 0.2),
    ("h2", "local", "continuous", "exact", 0.1),
    ("pump", "input", "continuous", "", 0.0),
    ("a1", "parameter", "fixed", "exact", 7.1e-6),
    ("a2", "parameter", "fixed", "exact", 6.3e-6),
    ("k", "parameter", "fixed", "exact", 1.0),
    ("level", "output", "continuous", "calculated", None),
    ("second", "input", "continuous", "", 0.0),
)


def _attributes(variable, own_start):
    name, causality, variability, initial, start = variable
    if own_start and causality == "local":
        initial, start = "calculated", None
    found = {"name": name, "causality": causality, "variability": variability, "initial": initial}
    text = " ".join(f'{key}="{value}"' for key, value in found.items() if value)
    return text, "" if start is None else f' start="{start!r}"'


def description(version, *, own_start=False, once=False, says_step=False, step=0.0):
    """Return modelDescription.xml; `says_step` writes the internal step into it."""
    entries = []
    for i, each in enumerate(_VARIABLES):
        text, start = _attributes(each, own_start)
        if version == 2:
            entries.append(f'<ScalarVariable {text} valueReference="{i}"><Real{start}/></ScalarVariable>')
        else:
            entries.append(f'<Float64 {text} valueReference="{i}"{start}/>')
    clock = 'name="time" causality="independent" variability="continuous" valueReference="99"'
    entries.append(f"<Float64 {clock}/>" if version == 3 else f"<ScalarVariable {clock}><Real/></ScalarVariable>")
    limit = ' canBeInstantiatedOnlyOncePerProcess="true"' if once else ""
    limit += f' fixedInternalStepSize="{step}"' if says_step else ""
    side = f'<CoSimulation modelIdentifier="tanks"{limit}/>'
    variables = f"<ModelVariables>{''.join(entries)}</ModelVariables>"
    if version == 2:
        head = 'fmiVersion="2.0" modelName="tanks" guid="{1}"'
        structure = '<ModelStructure><Outputs><Unknown index="7"/></Outputs></ModelStructure>'
    else:
        head = 'fmiVersion="3.0" modelName="tanks" instantiationToken="{1}"'
        structure = '<ModelStructure><Output valueReference="6"/></ModelStructure>'
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription {head}>{side}{variables}{structure}'
        "</fmiModelDescription>"
    )


def missing_functions(source, version):
    """Return the functions of the standard that a source does not define: fmpy looks for all of them."""
    text = source.read_text()
    slave = {2: fmpy.fmi2.FMU2Slave, 3: fmpy.fmi3.FMU3Slave}[version]
    return [name for name in dir(slave) if name.startswith(f"fmi{version}") and f"{name}(" not in text]


def build(directory, version, step=0.0, **options):
    """Compile a unit, with an internal step [s] or steps of any length, and return its file."""
    directory.mkdir(parents=True, exist_ok=True)
    binary, file = directory / "tanks.so", directory / f"tanks{version}.fmu"
    # Without fused operations, which round once and not twice.
    flags = ["-shared", "-fPIC", "-O1", "-ffp-contract=off", "-w"]
    source, others = SOURCES / f"tanks{version}.c", directory / "others.c"
    others.write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in missing_functions(source, version)))
    subprocess.run(["gcc", *flags, f"-DSTEP={step}", "-o", binary, source, others, "-lm"], check=True)
    platform = "linux64" if version == 2 else "x86_64-linux"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", description(version, step=step, **options))
        archive.write(binary, f"binaries/{platform}/tanks.so")
    return file
