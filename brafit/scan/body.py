def propose(cloud):
    raise NotImplementedError
