"""What the words of an evaluation mean, said plainly where the mouse rests on them."""

from __future__ import annotations

from collections.abc import Mapping

MODULES: Mapping[str, str] = {
    "PARSE": "Reading the sentence. What the sentence was meant to say, in place of what was read.",
    "RECALL": "Finding the things. Every thing that the detector missed is given to the pipeline as a candidate.",
    "LIFT": "Pixels to 3D. Every candidate gets the 3D points and the box of its labelled pixels.",
    "SRM": "Judging relations. Every pair gets the relation that is labelled: .99, .5 or .01.",
    "ATTRIBUTE": "Judging colours, sizes and shapes. Every thing gets those that are known of it.",
    "CONF":
        "Trusting detections. Right things of the asked class get a confidence of .99, all others .01. An answer "
        "that this mends and that a false detection has won has the verdict OPM-CONF.",
    "residual":
        "What is wrong even with all modules replaced by the truth: wrong labels, ties, and pairs that count as "
        "one thing.",
}  # fmt: skip
"""The modules that are replaced by the truth, and what that means."""

WORDS: Mapping[str, str] = {
    "accuracy":
        "How often the answer is right. Every target that the sentence is true of counts: so it is higher than "
        "the share of CORRECT, which asks for the very target that was labelled.",
    "CORRECT":
        "The answer is the labelled target. Answers that are right, too, though another target was labelled, are "
        "LABEL.",
    "lucky": "The target is right, but with a reference of which the sentence is not true.",
    "margin":
        "How far the right pair is ahead: its score S less that of the best wrong pair. Below 0 the wrong pair "
        "won. S is the sum of the logarithms of the three factors: target, reference, relation.",
    "interval": "Where the figure would lie in 95 of 100 repetitions with other scenes like these.",
    "share":
        "Each module's fair share of what is lost (Shapley value): what replacing it by the truth gains, averaged "
        "over all orders of replacing. These add up to 100 with the accuracy.",
    "alone":
        "The accuracy with this module alone replaced by the truth. These do not add up, since one sentence can "
        "fail for several reasons.",
    "below": "Below 0: the module's errors made up for those of another.",
    "mended": "The failures that the truth in place of this module alone would mend.",
    "McNemar": "How likely so uneven a number of fixed and broken would be by chance, if both runs were equally good.",
    "facet": "Counts are of the expressions that all other filters leave.",
}  # fmt: skip

CHANGES: Mapping[str, tuple[str, str]] = {
    "fixed": ("fixed", "wrong in the first run, right in the second"),
    "broken": ("broken", "right in the first run, wrong in the second"),
    "verdict": ("changed verdict", "as right or as wrong as before, for the same answer, but with another verdict"),
    "other_reason": ("right for another reason",
                     "right in both, with another target or reference, or a pair that is right only in one of them"),
    "same": ("the same", "the same verdict, and right in both or wrong in both"),
}  # fmt: skip
"""What a second run made of an expression: the name, and what it means."""
