"""Honest results that the battery alters: a small experiment, one with an own component, a tuned one, and shards."""

import shutil
from pathlib import Path
from typing import NamedTuple

import own_files
import small_experiment
import tuned_experiment

PLAIN = {
    "runs": 4,
    "record": "{runs: 2}",
    "evaluate": "[runs, ensemble]",
    "claims": "[{id: c1, says: S, source: Fig. 1, check: 'mean(mse[S-MPC]) > 0', finding: confirmed}]",
}
TUNED = {"runs": 4, "tune": "{budget: 4, runs: 3}"}
METHOD = {"plain": "S-MPC", "owned": "Own", "tuned": "KF", "shards": "S-MPC"}
"""A method of each experiment."""


class Honest(NamedTuple):
    """Directories of results, and archives of those without shards.

    Parameters
    ----------
    outcomes : how the commands ended that have made them
    """

    root: Path
    outcomes: tuple

    def directory(self, name):
        """Results of an experiment."""
        return self.root / name

    def archive(self, name):
        """The packed results."""
        return self.root / f"{name}.zip"

    def config(self, name):
        """The configuration."""
        return self.root / "configs" / name / ("tuned.yaml" if name == "tuned" else "tiny.yaml")

    def copy(self, name, to):
        """Copy the results of an experiment; return the new directory."""
        return Path(shutil.copytree(self.directory(name), to))


def write_plain(directory, **keys):
    """Write the configuration of the small experiment and return its path."""
    directory.mkdir(parents=True, exist_ok=True)
    return small_experiment.write(directory, **PLAIN | keys)


def make(server, root):
    """Compute and pack all of them, each command under the audit hook."""
    configs, tmp = root / "configs", root / "tmp"
    tmp.mkdir(parents=True)
    paths = {"plain": write_plain(configs / "plain"), "shards": write_plain(configs / "shards", record=None)}
    (configs / "tuned").mkdir()
    paths["tuned"] = tuned_experiment.write(configs / "tuned", **TUNED)
    paths["owned"] = own_files.write(configs / "owned")
    outcomes = []

    def command(*words):
        allowed = {"write": [root], "code": [root], "git": True}
        outcomes.append(server.run(words, cwd=root, tmp=tmp, hostile=[root], **allowed))

    for name, path in paths.items():
        shards = ["1/2", "2/2"] if name == "shards" else [None]
        for shard in shards:
            chosen = () if shard is None else ("--shard", shard)
            command("run", path, "-o", root / name, "-j", 1, "--progress", "none", *chosen)
        command(*(("merge", root / name) if name == "shards" else ("pack", root / name, "-o", root / f"{name}.zip")))
    return Honest(root, tuple(outcomes))
