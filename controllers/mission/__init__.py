"""Steps between the chapters: arms that are moved to look, rovers that go somewhere."""
