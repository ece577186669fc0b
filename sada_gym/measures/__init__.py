"""How good an attack is: fooling rates, coverage, novelty, search, and statistics over runs."""
