"""The paper's experiment again: its table and figures on six skeins, and what 500 say of each."""
