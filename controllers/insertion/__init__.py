"""Insertion of a card or a segment into a slot (Thesis sections 5.2, 5.3 and A.4).

Drawing and estimate:

- `drawing`: card, slot, their markers, and obstacles about them.
- `slot_belief`: the slave's estimate of the slot's pose.

Contact, in the plane:

- `contact`, `contact_states`: forces of a card in a slot, and classification of its six states.
- `guide`: insertion in the direction of least resistance, and straight ahead for comparison.
- `seating`: the same into card guides, until the card has snapped in.

One card, two rovers: the master measures card and slot, the slave moves the card:

- `camera_station`, `watching`: pose of the master, and the best view of its camera.
- `guidance`: message with the pose of the slot in the card's frame, by the master's cameras.
- `marker_guide`: the master's measurements and camera motion.
- `card_arm`, `card_inserter`: the slave's arm with the card, and its insertion.
- `team`: master and slave, joined by their messages alone.

One segment in two grips (figure A-8):

- `planar_grip`: the gripper in the plane of its arm, and the wrench that it exerts.
- `cooperation`: hybrid position and force control of the grips, and the pair's messages.
- `master_slave`: the master that plans and guides, the slave that follows.
"""
