"""Choice of parameters on runs that the experiment never uses: the searches, their trials and their record.

`search.py` says which values are tried next, `rounds.py` computes their trials in a store of their own, `record.py`
keeps what was found in tuning.json, and `tune.py` puts the three together.
"""
