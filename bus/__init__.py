"""The bus between processes: messages, who may send them, and how they travel."""
