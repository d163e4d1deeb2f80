"""Plant model: vehicle, adhesion laws, equations of motion (`plant`), numeric functions and linearisation."""
