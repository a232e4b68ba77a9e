"""What each kind of knowledge is worth to an insertion, axis by axis of what makes it harder."""
