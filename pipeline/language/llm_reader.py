"""A language model as a reader of sentences: constrained to the grammar's tree, checked, and marked like the grammar.

The model is asked with a JSON schema made of `pipeline.language.tree`; its words are looked for in the sentence, and
what it leaves over is marked as unused. What it answers is kept on disk, so that the same question is asked once.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import count
from typing import Any

from pydantic import TypeAdapter

from pipeline.language import lexicon
from pipeline.language.attributes import Attribute, attribute
from pipeline.language.chain import Clause
from pipeline.language.expression import MOST_RELATIONS, offered
from pipeline.language.grammar import with_unused
from pipeline.language.naming import DETERMINERS, Synonyms, default_synonyms
from pipeline.language.relation_names import MIRRORED, PHRASE
from pipeline.language.tokens import NameIndex, check_text, label_of, tokenize, vocabulary
from pipeline.language.tree import Attachment, Node, Query, Reading, Role, Span, described
from pipeline.system.chat import ChatClient
from pipeline.system.errors import InputError, ServerError, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import checked

MOST_CHARACTERS, MOST_THINGS = 20_000, 100
"""No tree of a sentence is longer, and nobody counts further."""

_TASK = """Read what a sentence asks for in a picture of a room, as a tree: the thing that is asked for, how it looks
(attributes), which of several such things it is (choices), and its relations to other things, which may have relations
themselves. Take names, phrases and texts from the sentence, word for word and without articles. A relation holds from
the thing that it modifies to its nodes; "inverse" says that it holds from the node to the thing: "table holding a
lamp" is a table with the relation "on", inverse, to a lamp. A thing with no name of its own is "thing". Leave out what
the tree has no place for.
Relations, and how they are said: """


@dataclass(frozen=True)
class _Reply:
    """What is asked for."""

    target: Node


_REPLY = TypeAdapter(_Reply)
_OURS = ("mention", "mapped_from", "note")
"""Fields that follow from the others."""


def tree_schema() -> dict[str, Any]:
    """JSON schema of the tree, as strict servers want it: every field required, and no other."""
    schema = _REPLY.json_schema()
    for table in (schema, *schema["$defs"].values()):
        fields = {name: field for name, field in table["properties"].items() if name not in _OURS}
        for field in fields.values():
            field.pop("default", None)
        table |= {"properties": fields, "required": list(fields), "additionalProperties": False}
    schema["$defs"]["Attachment"]["properties"]["relation"]["enum"] = list(PHRASE)
    return schema


class LlmReader:
    """Reads sentences by a model behind OpenAI's chat protocol; called like `pipeline.language.expression.parse`.

    The arguments are those of `pipeline.system.chat.ChatClient`.
    """

    def __init__(self, url: str, model: str, **options: Any) -> None:
        form = {"type": "json_schema", "json_schema": {"name": "tree", "strict": True, "schema": tree_schema()}}
        defaults: dict[str, Any] = {"timeout_s": 60.0, "retries": 1, "max_tokens": 2048}
        self._client = ChatClient(url, model, extra={"response_format": form}, **(defaults | options))
        self.name = f"llm {model}"

    def __call__(
        self,
        text: str,
        *,
        class_names: Sequence[str] = (),
        relations: Collection[str] | None = None,
        synonyms: Synonyms | None = None,
    ) -> Query:
        """Read a sentence, with a second try where the reply cannot be used.

        ServerError where the server gives no answer; InputError where the sentence cannot be read at all, or the second
        reply is no tree of it either, with the reason.
        """
        known = vocabulary(tuple(class_names), synonyms or default_synonyms())
        with_unused(check_text(text), known, ())  # What no tree can say is refused, and nobody is asked.
        names = [t.name for t in tokenize(text, known) if t.name is not None]
        prompt = _TASK + ", ".join(f"{name} ({phrase})" for name, phrase in PHRASE.items())
        prompt += f"\nNames that belong together: {', '.join(names)}" if names else ""
        prompt += f"\nSentence: {text}"

        def read(reply: str) -> Query:
            root, spans = _Found(text, known, relations).tree(reply)
            return Query(text, (Reading(root, True, described(root)),), with_unused(text, known, spans), self.name)

        for again in (True, False):
            try:
                return read(self._client.ask(prompt, None, check=read).text)
            except ServerError:
                raise
            except InputError as error:
                if not again:
                    raise type(error)(f"{self.name} gave no tree that can be used: {error}") from error
                prompt += f"\nAn earlier answer could not be used: {error}"
        raise AssertionError("unreachable")


class _Found:
    """A tree under construction, and the words of the sentence in use."""

    def __init__(self, text: str, known: NameIndex, relations: Collection[str] | None) -> None:
        self.text, self.known, self.relations = text, known, relations
        self.nouns, self.parts = count(), count()
        self.used: list[tuple[Role, int, list[str]]] = []

    def tree(self, reply: str) -> tuple[Node, list[Span]]:
        """Target of a reply, and the spans of its words; InputError for no tree, or a meaningless tree."""
        what = "it is no tree of the sentence"
        require(len(reply) <= MOST_CHARACTERS, what, got=f"{len(reply)} characters")
        root = self._node(checked(_REPLY.validate_json, reply, f"{what} at {{}}").target)
        relations = next(self.parts)
        require(not root.viewer, what, got="the viewer as the thing that is asked for")
        require(relations <= MOST_RELATIONS, what, got=f"{relations} relations", expected=f"at most {MOST_RELATIONS}")
        return root, list(self._spans())

    def _node(self, node: Node) -> Node:
        mention = next(self.nouns)
        attributes = tuple(attribute(str(a)) or Attribute("other", check_text(a.value)) for a in node.attributes)
        forms = {a: [w for w in re.findall(r"[\w-]+", self.text) if attribute(w) == a] or [str(a)] for a in attributes}
        name = self._name(node.head or node.label)
        name = " ".join(w for w in name.split() if attribute(w) not in attributes) or name
        label = self._name(node.label)
        label = " ".join([*(words[0].lower() for words in forms.values()), name]) if label == name else label
        choices = tuple(replace(c, text=self._own(c.text, c.order)) for c in node.choices)
        numbers = [n for n in (node.count, *(c.rank for c in choices)) if n is not None]
        require(all(1 <= n <= MOST_THINGS for n in numbers), "numbers of things", expected=f"1 to {MOST_THINGS}")
        self.used.append(("reference" if mention else "target", mention, [node.label, label, node.head, name]))
        self.used.extend(("attribute", mention, words) for words in forms.values())
        self.used.extend(("choice", mention, [c.text]) for c in choices)
        return replace(
            node,
            label=label,
            head=name if name != label else "",
            mention=mention,
            attributes=attributes,
            choices=choices,
            attachments=tuple(map(self._attachment, node.attachments)),
            excluded=tuple(map(self._node, node.excluded)),
        )

    def _own(self, words: str, otherwise: str) -> str:
        """Words of the sentence, or `otherwise` where they are others."""
        own = set(words.lower().split()) <= set(re.findall(r"[\w'’-]+", self.text.lower()))
        return words if words.strip() and own else otherwise

    def _name(self, words: str) -> str:
        tokens = [t for t in tokenize(check_text(words), self.known) if t.plain not in DETERMINERS]
        require(tokens, "a thing without a name", got=repr(words))
        return label_of(words, tokens)

    def _attachment(self, attachment: Attachment) -> Attachment:
        relation, needed = attachment.relation, 2 if attachment.relation == "between" else 1
        require(relation in PHRASE, "unknown relation", got=repr(relation)[:60], expected=f"one of {', '.join(PHRASE)}")
        require(
            len(attachment.nodes) == needed, f"the references of {relation}", got=len(attachment.nodes), expected=needed
        )
        turns = relation in MIRRORED or relation in lexicon.SAYS_SWAPPED
        require(turns or not attachment.inverse, f"{relation} cannot be said from the other side")
        phrase = self._own(attachment.phrase, PHRASE[relation])
        self.used.append(("relation", next(self.parts), [phrase]))
        clause = Clause(relation, phrase, (), attachment.inverse, negated=attachment.negated)
        return replace(offered(clause, self.relations), nodes=tuple(map(self._node, attachment.nodes)))

    def _spans(self) -> Iterator[Span]:
        """Stretches of the sentence in use, the longest first, none twice."""
        left = self.text
        for role, index, forms in sorted(self.used, key=lambda s: -len(s[2][0])):
            single = [w for w in forms[0].split() if w.lower() not in DETERMINERS]
            for form in (*([form] for form in forms), single):
                before = left
                for words in filter(str.strip, form):
                    pattern = r"[\s_-]+".join(map(re.escape, re.split(r"[\s_-]+", words.strip())))
                    if found := re.search(rf"(?<!\w){pattern}(?!\w)", left, re.I):
                        # What is taken is blanked, so that the second mug of two is another one.
                        left = left[: found.start()] + "\0" * len(found[0]) + left[found.end() :]
                        yield Span(found.start(), found.end(), role, index)
                if left != before:
                    break
