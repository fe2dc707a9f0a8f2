"""Every assumption, lemma, theorem and equation of the paper as a check that can fail; one module for each result."""
