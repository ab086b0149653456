"""The relation network made from labels or rendered rooms: data, fitting, cards, ablation."""
