"""A sentence to an expression: tokens, grammar, names, relation names, phrases, text vectors."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.language.attributes import BASIC_COLORS, Attribute, attribute
    from pipeline.language.class_sizes import is_thin, size_factor, size_range
    from pipeline.language.expression import parse, sentence_kind
    from pipeline.language.glossary import find_term, glossary_markdown
    from pipeline.language.lexicon import wording
    from pipeline.language.llm_reader import LlmReader
    from pipeline.language.naming import (
        Meaning,
        Synonyms,
        default_synonyms,
        is_named,
        match,
        meanings,
        normal_form,
        same_class,
        suggest,
    )
    from pipeline.language.noun_phrase import readable, same_names
    from pipeline.language.relation_names import (
        DIRECTIONAL,
        HORIZONTAL,
        INVERSE,
        MIRRORED,
        PAIRWISE,
        PHRASE,
        RELATIONS,
        VOCABULARIES,
    )
    from pipeline.language.tree import QUERY_KINDS, Attachment, Choice, Node, Query, Reading
    from pipeline.language.vectors import LanguageContract, VectorFile, open_vectors

__getattr__ = lazy_exports(__name__, __file__)
