"""Alembic's entry: migrations run on the connection that Database.migrate hands over, in its transaction."""

from __future__ import annotations

from alembic import context

from penumbra_service.store.schema import metadata

context.configure(
    connection=context.config.attributes["connection"], target_metadata=metadata, render_as_batch=True
)
with context.begin_transaction():
    context.run_migrations()
