"""Archives of results that somebody else can check."""
