"""`cell plan`: the pipeline, its artefacts, its report."""
