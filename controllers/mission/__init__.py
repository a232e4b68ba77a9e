"""Steps between the chapters: rovers that go somewhere."""
