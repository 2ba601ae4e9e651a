"""Plans: states and controls of each craft, with a certificate that anyone can check."""
