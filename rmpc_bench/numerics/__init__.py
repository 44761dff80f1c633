"""Mathematics without control: arrays in, arrays out."""
