"""Other libraries on the bench, one file each; the library itself is imported when its adapter is used."""
