"""Jobs, API keys and assets."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    time = sa.DateTime(timezone=True)
    op.create_table(
        "api_keys",
        sa.Column("id", sa.String(26), primary_key=True),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("digest", sa.LargeBinary(32), nullable=False, unique=True),
        sa.Column("hint", sa.String(16), nullable=False),
        sa.Column("created", time, nullable=False),
        sa.Column("revoked", time),
    )
    op.create_table(
        "jobs",
        sa.Column("id", sa.String(26), primary_key=True),
        sa.Column("state", sa.String(20), nullable=False),
        sa.Column("priority", sa.Integer, nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("request", sa.Text, nullable=False),
        sa.Column("progress", sa.JSON, nullable=False),
        sa.Column("revision", sa.Integer, nullable=False),
        sa.Column("crashes", sa.Integer, nullable=False),
        sa.Column("reason", sa.Text),
        sa.Column("owner", sa.String(26), sa.ForeignKey("api_keys.id")),
        sa.Column("idempotency_scope", sa.String(26)),
        sa.Column("idempotency_key", sa.String(255)),
        sa.Column("body_digest", sa.String(64), nullable=False),
        sa.Column("created", time, nullable=False),
        sa.Column("updated", time, nullable=False),
        sa.Column("started", time),
        sa.Column("finished", time),
        sa.UniqueConstraint("idempotency_scope", "idempotency_key", name="one_job_per_idempotency_key"),
    )
    op.create_index("jobs_by_queue_order", "jobs", ["state", "priority", "id"])
    op.create_table(
        "assets",
        sa.Column("sha256", sa.String(64), primary_key=True),
        sa.Column("bytes", sa.BigInteger, nullable=False),
        sa.Column("kind", sa.String(20), nullable=False),
        sa.Column("format", sa.String(20), nullable=False),
        sa.Column("detail", sa.String(200), nullable=False),
        sa.Column("owner", sa.String(26), sa.ForeignKey("api_keys.id")),
        sa.Column("created", time, nullable=False),
    )


def downgrade() -> None:
    op.drop_table("assets")
    op.drop_index("jobs_by_queue_order", "jobs")
    op.drop_table("jobs")
    op.drop_table("api_keys")
