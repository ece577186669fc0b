"""The walking policy of others, and the file that `sada-gym fetch go2-walk` makes."""
