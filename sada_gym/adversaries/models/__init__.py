"""What several solvers fit to points and scores: mixtures, Gaussian processes, surrogates."""
