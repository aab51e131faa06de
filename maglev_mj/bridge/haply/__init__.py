"""Door to three-axis arms behind the JSON of Haply's Inverse service: such an arm as a plant, and its twin."""
