"""The paper's experiments: one module per figure, each with a function `main(output)`."""
