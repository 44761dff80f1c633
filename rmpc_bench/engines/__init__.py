"""Engines, which compute tasks: in this process, or in worker processes.

Results arrive in any order, and they do not depend on the engine.
"""
