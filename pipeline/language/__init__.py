"""A sentence to an expression: tokens, grammar, names, relation names, phrases, text vectors."""
