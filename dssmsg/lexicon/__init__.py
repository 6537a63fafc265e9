"""Household English by table: sentences become target graphs, labels a measure of how things move.

    words      tokens, singulars, stems
    tables     the readable YAML: labels, grammar, needs, rooms; packaged, and a user's own over it
    terms      the longest known phrase at every word
    opening    what a sentence begins with: asking, wanting, refusing
    reading    a sentence -> things, attributes, relations (explicit queries of paper III-C)
    needs      a sentence -> what serves its purpose (implicit queries)
    target     both put together: the target graph as the JSON that a language model would give
    movement   label, size and surroundings -> how readily a thing is moved (paper III-A)

Nothing here is learnt and nothing asks a network; where no wording fits a text encoder helps.
"""
