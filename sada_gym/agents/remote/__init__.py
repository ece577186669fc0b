"""Agents in a process of their own, which may have another Python and other packages."""
