"""From a YAML file to an ExperimentConfig.

`load_config` (load.py) calls seven stages in this order.  Each is one module with one public function, of this room or
of `config_file`:

=====================  =================  =======================================================================
stage                  module             result
=====================  =================  =======================================================================
1 read                 source.py          tree of the file and the overrides; every value knows its line and column
2 inherit              inherit.py         the tree with overrides and the files of ``plant.from`` in place
3 expand the sweep     sweep.py           one tree per point of the sweep
4 validate             validation.py      sections and components of every point (draft.py)
5 build                build.py           designs of every point and the data that identify its trials
6 check                checks.py          claims, figures, and names that one section uses of another
7 canonicalise         canonical.py       ExperimentConfig, with every default filled in (experiment_config.py)
=====================  =================  =======================================================================

Used by the stages:

- trees with places, keys of a component and the messages about them: the room config_file;
- keys: sections.py (top level), plugins.py; stage 3: sweep_section.py (reads and checks the sweep);
- stage 4: draft.py (the sections of a point), noise_section.py (uncertainty, noise, initial state);
- stage 5: build_method.py (model, estimator, controller), build_noise.py, identity.py (what is hashed), sweep_point.py
  (the hashes of a point);
- stage 6: result_layout.py (what the results will contain), claim_checks.py, figure_checks.py, evaluation_checks.py;
- errors: origin.py (an error in an inherited value is reported once, where the value is written).
"""
