"""What several solvers fit: mixtures, Gaussian processes, surrogates, and the GAN."""
