"""Environment of the migrations: they run on the connection that the service has opened."""

from alembic import context

from skyrange.runtime.utm.database.tables import METADATA

context.configure(connection=context.config.attributes["connection"], target_metadata=METADATA)
with context.begin_transaction():
    context.run_migrations()
