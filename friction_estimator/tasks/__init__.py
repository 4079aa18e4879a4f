"""Many pieces of work on processes of this machine or on a cluster; what is known of friction is not in here."""
