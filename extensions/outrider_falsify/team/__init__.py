"""Attack on the guarantee of a team: deaths, blackouts, requests and a UGV that flees."""
