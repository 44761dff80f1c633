"""Choice of parameters on runs that the experiment never uses: the searches, their trials and their record.

`search.py` says which values are tried next, `rounds.py` computes their trials in a store of their own, and `tune.py`
puts the two together.  What was found is in tuning.json, which the room `results` reads and writes.
"""
