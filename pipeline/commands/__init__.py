"""The commands of ``deep-contact``, each a dataclass whose fields are its options, which runs when it is called."""
