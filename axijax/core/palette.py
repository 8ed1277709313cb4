"""The colours and line styles of every picture."""

# Told apart by the colour-blind (Okabe and Ito 2008); lines beyond them change their style.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
STYLES = ("-", "--", "-.", ":")
