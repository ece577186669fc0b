"""The driving world: towns, routes, vehicles, weathers."""
