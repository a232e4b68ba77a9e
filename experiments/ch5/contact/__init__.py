"""A card on a bench, inserted by what the hand feels (``ch5-contact``, figures A-5 to A-7).

- `contact`: measures and checks; its options beside it.
- `bench`: compliant hand at a slot, and its true contacts.
- `trial`: contact states, and insertions into the plain slot.
- `seating`, `seating_trial`: insertions into card guides, in three ways.
- `figures`, `record`: figures and a recording.
"""
