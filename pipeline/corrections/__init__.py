"""Correcting labels by hand: an editor for one person, and the labelled objects in 3D.

`label_editor` keeps what one person sees, saves and takes back, `unsaved` what
could not be saved yet or is disputed, `journal_location` the journal that all
share. `scene` makes objects and cases of a frame's effective labels, `cards` and
`object_card` say what is known of a pair, an object or an expression, and where
from; `draft` and `side_views` are edits of pixels and of 3D boxes.
"""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.corrections.draft import (
        Draft,
        edits_of_draft,
        lifted_draft,
        new_draft,
        rebased,
        with_depth_split,
        with_gesture,
    )
    from pipeline.corrections.journal.batch import actions_of, apply_actions, needs_pictures, read_actions
    from pipeline.corrections.journal.connection import back_up, check_journal, recover
    from pipeline.corrections.journal.edits import (
        judge_relation,
        set_box,
        set_class,
        set_mark,
        set_relation,
        set_status,
        set_text,
    )
    from pipeline.corrections.journal.effective import Corrector, effective_tables
    from pipeline.corrections.journal.effective_frame import EffectiveFrame
    from pipeline.corrections.journal.events import Conflict, Edit, Event, NotSaved, Saved
    from pipeline.corrections.journal.examining import DamagedJournal
    from pipeline.corrections.journal.field_refs import FieldRef, object_ref, relation_ref, same_value, shown_value
    from pipeline.corrections.journal.incoming.importing import (
        ImportConfig,
        ImportReport,
        import_corrections,
        import_record,
    )
    from pipeline.corrections.journal.journal import JOURNAL_FILE, Journal, journal_of, open_journal
    from pipeline.corrections.journal.materialise import materialise
    from pipeline.corrections.journal.replay import redo, undo
    from pipeline.corrections.judging import Judge, right_pair, why_not_kept
    from pipeline.corrections.label_editor import LabelEditor, LabelEditors
    from pipeline.corrections.object_card import (
        ExpressionCard,
        LabelView,
        back_to_automatic,
        bring_back,
        paired,
        set_answer,
    )
    from pipeline.corrections.review.doubts import DoubtConfig
    from pipeline.corrections.review.items import STATES, ItemKey, State, pair_agreements
    from pipeline.corrections.review.label_jobs import (
        CANCELLED,
        QueueJob,
        QueueProgress,
        RetrainingJob,
        RetrainingRun,
        run_retraining,
    )
    from pipeline.corrections.review.queue import (
        automatic_version,
        read_relation_labels,
        review_queue,
        reviewed_labels,
        states_on_labels,
    )
    from pipeline.corrections.review.retraining import RetrainConfig, Retraining, retrain
    from pipeline.corrections.review.worklist import (
        NOTHING,
        Worklist,
        accept_all,
        item_keys,
        read_queue,
        refreshed_worklist,
        say_of_item,
        worklist,
        write_queue,
    )
    from pipeline.corrections.scene import (
        ASKED_BEYOND_M,
        drag_box,
        dragged,
        effective_truth,
        face_to_points,
        fit_to_points,
        labelled_box,
        labelled_objects,
        pair_card,
    )
    from pipeline.corrections.unsaved import JournalLocation, Waiting, disputes, dump_unsaved
    from pipeline.corrections.vocabulary import Vocabulary, completions
    from pipeline.corrections.wording import consequences, events_text

__getattr__ = lazy_exports(__name__, __file__)
