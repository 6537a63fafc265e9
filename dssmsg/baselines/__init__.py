"""The published methods that `dssm` is compared with, as algorithms of our own writing.

ConceptGraphs (Gu et al., 2024) and DovSG (Yan et al., 2025), written from their papers and published
parameters; the plug-ins `association/conceptgraphs`, `association/dovsg` and `update/dovsg` wrap them. They
get the observations that `dssm` gets. Where they differ from the original is in docs/baselines.md.
"""
