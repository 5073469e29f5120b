"""Who sits in the UGV."""
