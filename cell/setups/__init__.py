"""Several set-ups of one part: what a set-up leaves open is planned for another pose of the part."""
