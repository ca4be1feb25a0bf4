def print_summary(folder): pass
def write_cell_report(config, folder): return ()
