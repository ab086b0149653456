"""STUB until merge."""
def find(records, query):
    import pyarrow.compute as pc
    for word in query.split():
        k,_,v=word.partition(":")
        if v and k in records.column_names:
            records=records.filter(pc.equal(records[k], v))
    return records
