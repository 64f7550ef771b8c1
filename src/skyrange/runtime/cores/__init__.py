"""One run on several cores: operators divided among processes that exchange what crosses between them at set times."""
