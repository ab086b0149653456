"""Words on a wrong imported answer without a known failed module."""

from __future__ import annotations


def unexplained(detail: str | None, target: str, answered: bool = True) -> str:
    """Verdict UNEXPLAINED in words: known facts, and data that would tell more.

    `detail`: ANSWER, PROPOSALS, BOXES: what the file gives; or NOT-SEPARABLE; `target`: the name that was asked for;
    `answered`: there is an answer.
    """
    wrong = "Wrong" if answered else "Not answered"
    proposed = f"{wrong}, and the right {target} was proposed"
    return {
        "ANSWER": f"{wrong}. The file gives no more than the answer; with its proposals (level 1) it could be said "
        "whether the right thing was seen at all.",
        "PROPOSALS": f"{proposed}. With 3D boxes (level 2), relation probabilities "
        "(level 3) and an answer that is one of the proposals it could be said why it lost.",
        "BOXES": f"{proposed}, where it is. With relation probabilities (level 3) and "
        "an answer that is one of the proposals it could be said whether these or the ranking are to blame.",
    }.get(
        detail or "",
        "Wrong, and not separable: what a pair would have scored with a true module does not follow from the scores of "
        "the file. A callback that ranks again would tell, or the probabilities that the ranking went by.",
    )
