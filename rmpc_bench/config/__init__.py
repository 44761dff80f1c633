"""From a YAML file to an ExperimentConfig.

`load_config` (load.py) calls seven stages in this order.  Each is one public function, of this room or of
`config_file`:

=====================  =================  =======================================================================
stage                  module             result
=====================  =================  =======================================================================
1 read                 extends.py         tree of the file and the overrides; every value knows its line and column
2 inherit              inherit.py         the tree with overrides and the files of ``plant.from`` in place
3 expand the sweep     sweep.py           one tree per point of the sweep
4 validate             validate.py        sections and components of every point (draft.py)
5 build                build.py           designs of every point and the data that identify its trials (identity.py)
6 check                check.py           claims, figures, names that one section uses of another, and warnings
7 canonicalise         load.py            ExperimentConfig, with every default filled in (experiment_config.py)
=====================  =================  =======================================================================

A stage returns what it makes: the sections of a point are a frozen `DraftConfig` (draft.py), of which `replace` makes
another.  Later stages add errors, warnings and what is left out to those of earlier ones.  What reads or builds one
value raises a ConfigError; `Problems.tried` collects it, so that one error hides no other.  What compares sections adds
its errors itself, by `note`.

A key of a configuration is in the file of its name (claims, delay, input, methods, noise, plant, plugins, report,
statistics, stop, sweep, tune), small ones in sections.py, `requires` in plugins.py, `uncertainty` and `initial` in
noise.py.  claim_keys.py has the keys of one claim.  The key `tune` of a method is in search.py, and rounds.py has the
designs of values that are tried.  designs.py makes the designs of one method.  warnings.py has what is valid and
probably not meant, left_out.py what is inherited and does not fit, own_code.py the files of users and the first calls
of their components.
"""
